// A kinematic tree as one chain of stages: solvers/tree/stages.py, which says what and why; names are the same.
#pragma once

#include <cstdint>

#include "dense.hpp"
#include "vectors.hpp"

namespace prioritized_ik {

// What the caller owns and fills, see `TreeRowsOnJoints` and `CompiledElimination` in Python.
struct TreeInput {
    int32_t joints, rows, levels;
    double zero, rounding, noise;  // TREE_ZERO, ROUNDING, NOISE
    const int32_t *parents, *row_joints, *row_levels;
    const double *angular, *linear, *anchors;    // (m, 3)
    const double *points, *directions, *roots;   // (k, 3), (k, 3), (k)
    const uint8_t *fixed, *counts;              // (m), (k)
    double *lengths, *strongest, *weakest;      // out (k), (levels + 1), (levels + 1)
    int32_t* ranks;                             // out (levels + 1)
};

constexpr int TWIST = 6;
constexpr int BASE = -1;

inline double product(const double* row, const double* twist) {
    double sum = 0.0;
    for (int i = 0; i < TWIST; i++) sum += row[i] * twist[i];
    return sum;
}

// A row on the twist at a point as one on that at a point an arm `a` back.
template <class T> void move_row(const T* row, const double* a, T* to) {
    to[0] = row[0] + a[1] * row[5] - a[2] * row[4];
    to[1] = row[1] + a[2] * row[3] - a[0] * row[5];
    to[2] = row[2] + a[0] * row[4] - a[1] * row[3];
    to[3] = row[3], to[4] = row[4], to[5] = row[5];
}

// The twist at a point as that at a point an arm `a` away.
template <class T> void move_twist(const T* twist, const double* a, T* to) {
    to[0] = twist[0], to[1] = twist[1], to[2] = twist[2];
    to[3] = twist[3] + twist[1] * a[2] - twist[2] * a[1];
    to[4] = twist[4] + twist[2] * a[0] - twist[0] * a[2];
    to[5] = twist[5] + twist[0] * a[1] - twist[1] * a[0];
}

// to := factors (k) times rows `stride` apart, of which n numbers, padded, are there to be read and written
inline void combine(const double* factors, const double* rows, int stride, int k, double* to, int n) {
    for (int j = 0; j < n; j += WIDE) {
        Wide one = {}, two = {};
        int i = 0;
        for (; i + 2 <= k; i += 2) {
            one += wide_of(factors[i]) * wide(rows + size_t(i) * stride + j);
            two += wide_of(factors[i + 1]) * wide(rows + size_t(i + 1) * stride + j);
        }
        if (i < k) one += wide_of(factors[i]) * wide(rows + size_t(i) * stride + j);
        wide(to + j) = one + two;
    }
}

// to += factors (k) times columns `stride` apart; of which n numbers, padded, are there to be read and written
inline void add_columns(const double* factors, const double* columns, int stride, int k, double* to, int n) {
    for (int j = 0; j < n; j += WIDE) {
        Wide sum = wide(to + j);
        for (int i = 0; i < k; i++) sum += wide_of(factors[i]) * wide(columns + size_t(i) * stride + j);
        wide(to + j) = sum;
    }
}

// `copy` where there are so few that a call takes longer.
template <class T> void copy_few(const T* from, T* to, int n) {
    for (int i = 0; i < n; i++) to[i] = from[i];
}

template <class T> void clear_few(T* a, int n) {
    for (int i = 0; i < n; i++) a[i] = T{};
}

struct Stage {
    int joints, count, before;  // its joints, base first, from joints_[joints] on; the stage that carries it
    int states, kept;           // how many twists are the state, and where they come from, in kept_[kept ...]
    double arm[3];
};

class Stages {
  public:
    std::vector<Stage> all;
    std::vector<int> joints, kept, of_joint, of_row;  // of_joint, of_row: the stage of each
    std::vector<double> axes, spread, given;  // (joints in order, 6), (stages, 6); rows on their joints' twists (k, 6)
    std::vector<double> zeros;                // what of each row of unit length is rounding (k)
    std::vector<uint8_t> real;                // which rows say anything (k)

    static constexpr int MOST = 6;  // joints of a stage

    void build(const TreeInput& in) {
        const double unit = unit_of(in);
        if (!is_known(in)) {
            sort_joints(in);
            add_states();
        }
        add_axes(in, unit);
        add_rows(in, unit);
        measure(in);
    }

    const double* row(int i) const { return given.data() + size_t(TWIST) * i; }
    const double* axis(const Stage& stage, int i) const { return axes.data() + size_t(TWIST) * (stage.joints + i); }

    // Twists (stages, 6) at a step u.
    void twists(const double* u, std::vector<double>& out) const {
        out.resize(all.size() * TWIST);
        for (size_t n = 0; n < all.size(); n++) {
            const Stage& stage = all[n];
            double* s = out.data() + n * TWIST;
            if (stage.before == BASE) clear(s, TWIST);
            else move_twist(out.data() + size_t(TWIST) * stage.before, stage.arm, s);
            for (int i = 0; i < stage.count; i++) {
                const double *g = axis(stage, i), value = u[joints[stage.joints + i]];
                for (int k = 0; k < TWIST; k++) s[k] += g[k] * value;
            }
        }
    }

  private:
    static constexpr double SHORT = 1e-5;  // [of its terms] a length this small is worked out anew
    static constexpr int WIDTH = 8, GRAM = TWIST * WIDTH;

    std::vector<uint8_t> carries_, carrying_;  // which joints carry rows; of the tree before
    std::vector<int32_t> parents_;
    std::vector<double> away_, grams_;

    // Whether the stages are those of the tree before: which joints carry each other, and which carry rows.
    bool is_known(const TreeInput& in) {
        carries_.assign(in.joints, 0);
        for (int i = 0; i < in.rows; i++) carries_[max(in.row_joints[i], 0)] = 1;
        if (carries_ == carrying_ && int(parents_.size()) == in.joints &&
            std::equal(parents_.begin(), parents_.end(), in.parents))
            return true;
        carrying_ = carries_;
        parents_.assign(in.parents, in.parents + in.joints);
        return false;
    }

    void sort_joints(const TreeInput& in) {
        const int m = in.joints;
        std::vector<int> weight(m, 1), first(m + 1, BASE), next(m, BASE), children(m + 1, 0), some;
        for (int j = m - 1; j >= 0; j--) {
            const int at = in.parents[j] < 0 ? m : in.parents[j];
            if (at < m) weight[at] += weight[j];
            next[j] = first[at];
            first[at] = j;
            children[at]++;
        }
        all.clear(), joints.clear();
        of_joint.assign(m, 0);
        std::vector<std::pair<int, int>> waiting;
        const auto push = [&](int at, int before) {
            some.clear();
            for (int j = first[at]; j >= 0; j = next[j]) some.push_back(j);
            if (some.size() > 1)
                std::sort(some.begin(), some.end(), [&](int a, int b) {
                    return weight[a] != weight[b] ? weight[a] > weight[b] : a > b;
                });
            for (int j : some) waiting.push_back({j, before});
        };
        push(m, BASE);
        while (!waiting.empty()) {
            auto [j, before] = waiting.back();
            waiting.pop_back();
            Stage stage{int(joints.size()), 0, before, 0, 0, {}};
            for (;;) {
                joints.push_back(j);
                of_joint[j] = int(all.size());
                stage.count++;
                if (children[j] != 1 || carrying_[j] || stage.count == MOST) break;
                j = first[j];
            }
            all.push_back(stage);
            push(j, int(all.size()) - 1);
        }
    }

    void add_states() {
        const int count = int(all.size());
        std::vector<int> last(count, -1), state, now;
        for (int n = 0; n < count; n++)
            if (all[n].before != BASE) last[all[n].before] = n;
        kept.clear();
        for (int n = 0; n < count; n++) {
            Stage& stage = all[n];
            stage.kept = int(kept.size());
            const auto place = [&](int of) { return int(std::find(state.begin(), state.end(), of) - state.begin()); };
            kept.push_back(stage.before == BASE ? -1 : place(stage.before));
            now.assign(1, n);
            for (int other : state)
                if (last[other] > n) {
                    kept.push_back(place(other));
                    now.push_back(other);
                }
            stage.states = int(now.size());
            state.swap(now);
        }
    }

    void add_axes(const TreeInput& in, double unit) {
        axes.resize(size_t(TWIST) * in.joints);
        for (Stage& stage : all) {
            double* a = stage.arm;
            a[0] = a[1] = a[2] = 0.0;
            for (int i = stage.count - 1; i >= 0; i--) {
                const int j = joints[stage.joints + i], before = in.parents[j];
                double own[TWIST];
                for (int k = 0; k < 3; k++) {
                    own[k] = in.angular[size_t(3) * j + k];
                    own[3 + k] = in.linear[size_t(3) * j + k] / unit;
                }
                move_twist(own, a, axes.data() + size_t(TWIST) * (stage.joints + i));
                if (before >= 0)
                    for (int k = 0; k < 3; k++) a[k] += (in.anchors[size_t(3) * j + k] - in.anchors[size_t(3) * before + k]) / unit;
            }
        }
    }

    // See `TreeRowsOnJoints.unit`.
    double unit_of(const TreeInput& in) {
        away_.clear();
        for (int i = 0; i < in.rows; i++) {
            if (in.row_joints[i] < 0) continue;
            const double *p = in.points + size_t(3) * i, *c = in.anchors + size_t(3) * in.row_joints[i];
            const double x = p[0] - c[0], y = p[1] - c[1], z = p[2] - c[2], square = x * x + y * y + z * z;
            if (square > 0.0) away_.push_back(square);
        }
        if (away_.empty()) return 1.0;
        const auto middle = away_.begin() + away_.size() / 2;
        std::nth_element(away_.begin(), middle, away_.end());
        return away_.size() % 2 ? sqrt(*middle) : 0.5 * (sqrt(*middle) + sqrt(*std::max_element(away_.begin(), middle)));
    }

    // See `TreeRowsOnJoints.given`.
    void add_rows(const TreeInput& in, double unit) {
        given.resize(size_t(TWIST) * in.rows);
        of_row.resize(in.rows);
        for (int i = 0; i < in.rows; i++) {
            const int j = in.row_joints[i];
            of_row[i] = of_joint[max(j, 0)];
            double *c = given.data() + size_t(TWIST) * i, lever[3];
            if (j < 0) {
                clear(c, TWIST);
                continue;
            }
            for (int k = 0; k < 3; k++) lever[k] = (in.points[size_t(3) * i + k] - in.anchors[size_t(3) * j + k]) / unit;
            cross(lever, in.directions + size_t(3) * i, c);
            copy(in.directions + size_t(3) * i, c + 3, 3);
            for (int k = 0; k < TWIST; k++) c[k] *= unit;
        }
    }

    // How much twists and rows move, and what of rows is rounding.
    void measure(const TreeInput& in) {
        grams_.resize(all.size() * GRAM);
        spread.resize(all.size() * TWIST);
        for (size_t n = 0; n < all.size(); n++) {
            const Stage& stage = all[n];
            Four low[TWIST], high[TWIST];  // numbers 0 to 3, and 4 and 5, of each row
            if (stage.before == BASE)
                for (int i = 0; i < TWIST; i++) low[i] = high[i] = Four{};
            else {  // X G X^T, whose rows and columns are the same
                const double *from = grams_.data() + size_t(GRAM) * stage.before, *a = stage.arm, x = a[0], y = a[1], z = a[2];
                for (int i = 0; i < TWIST; i++) low[i] = four(from + i * WIDTH), high[i] = four(from + i * WIDTH + 4);
                low[3] += low[1] * z - low[2] * y, high[3] += high[1] * z - high[2] * y;
                low[4] += low[2] * x - low[0] * z, high[4] += high[2] * x - high[0] * z;
                low[5] += low[0] * y - low[1] * x, high[5] += high[0] * y - high[1] * x;
                for (int i = 0; i < TWIST; i++) {
                    const Four row = low[i], none = {};
                    high[i] += __builtin_shufflevector(row, none, 2, 0, 4, 4) * Four{x, y, 0.0, 0.0} -
                               __builtin_shufflevector(row, none, 0, 1, 4, 4) * Four{z, x, 0.0, 0.0};
                    low[i] += __builtin_shufflevector(row, none, 4, 4, 4, 1) * Four{0.0, 0.0, 0.0, z} -
                              __builtin_shufflevector(row, none, 4, 4, 4, 2) * Four{0.0, 0.0, 0.0, y};
                }
            }
            for (int i = 0; i < stage.count; i++) {
                const double* g = axis(stage, i);
                const Four first = four(g), second = {g[4], g[5], 0.0, 0.0};
                for (int p = 0; p < TWIST; p++) low[p] += first * g[p], high[p] += second * g[p];
            }
            const double squares[] = {low[0][0], low[1][1], low[2][2], low[3][3], high[4][0], high[5][1]};
            for (int i = 0; i < TWIST; i++) spread[n * TWIST + i] = sqrt(max(squares[i], 0.0));
            double* to = grams_.data() + n * GRAM;
            for (int i = 0; i < TWIST; i++) four(to + i * WIDTH) = low[i], four(to + i * WIDTH + 4) = high[i];
        }
        zeros.resize(in.rows);
        real.assign(in.rows, 0);
        double longest = 0.0;
        for (int i = 0; i < in.rows; i++) {
            const double* c = given.data() + size_t(TWIST) * i;
            const int n = of_row[i];
            const double* G = grams_.data() + size_t(GRAM) * n;
            double terms = 0.0;
            Four low = {}, high = {};
            for (int p = 0; p < TWIST; p++) {
                terms += abs(c[p]) * spread[size_t(TWIST) * n + p];
                low += four(G + p * WIDTH) * c[p], high += four(G + p * WIDTH + 4) * c[p];
            }
            double size = sqrt(max(total(low * four(c)) + (high[0] * c[4] + high[1] * c[5]), 0.0));
            if (size < SHORT * terms) size = length_anew(n, c);
            in.lengths[i] = size;
            zeros[i] = max(in.zero, in.rounding * terms / (size > 0.0 ? size : 1.0));
            longest = max(longest, size);
        }
        for (int i = 0; i < in.rows; i++) real[i] = in.lengths[i] > in.rounding * longest && in.roots[i] > 0.0;
    }

    double length_anew(int n, const double* on_twist) const {
        double row[TWIST], moved[TWIST], squares = 0.0;
        copy(on_twist, row, TWIST);
        for (;; n = all[n].before) {
            for (int i = 0; i < all[n].count; i++) {
                const double felt = product(row, axis(all[n], i));
                squares += felt * felt;
            }
            if (all[n].before == BASE) return sqrt(squares);
            move_row(row, all[n].arm, moved);
            copy(moved, row, TWIST);
        }
    }
};

}  // namespace prioritized_ik
