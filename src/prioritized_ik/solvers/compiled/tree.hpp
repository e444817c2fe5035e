// Strict levels of a kinematic tree, solved joint by joint from the tips to the base: solvers/tree/elimination.py, which says
// what and why; names are the same. A row on a joint's twist is eight doubles, two of them zeros.
#pragma once

#include <cstdint>

#include "dense.hpp"

namespace prioritized_ik {

// What the caller owns and fills, see `TreeRowsOnJoints` and `CompiledElimination` in Python.
struct TreeInput {
    int32_t joints, rows, levels;
    double zero, clear;  // TREE_ZERO, TREE_CLEAR
    const int32_t *parents, *row_joints, *row_levels;
    const double *axes, *arms, *covectors;  // (m, 6), (m, 3), (k, 6)
    const uint8_t *fixed, *counts;          // (m), (k)
    int32_t* owner;                         // out (m)
    double* pivot;                          // out (m)
};

// Length of each row's row of J (k), rows on twists being `given` (k, 6): all squares along the joints that move its point.
inline void row_lengths(const TreeInput& in, const double* given, double* out) {
    constexpr int N = 6;
    std::vector<double> grams(size_t(in.joints) * N * N);  // by joint, of what it and those before it make of its twist
    for (int j = 0; j < in.joints; j++) {
        double* G = grams.data() + size_t(j) * N * N;
        const double *a = in.arms + size_t(3) * j, *g = in.axes + size_t(N) * j;
        if (in.parents[j] >= 0) {
            copy(grams.data() + size_t(in.parents[j]) * N * N, G, N * N);
            if (a[0] != 0.0 || a[1] != 0.0 || a[2] != 0.0)  // v + w x a, in columns and in rows
                for (int side = 0; side < 2; side++) {
                    const int across = side ? 1 : N, along = side ? N : 1;
                    for (int k = 0; k < N; k++) {
                        double* x = G + k * across;
                        x[3 * along] += x[along] * a[2] - x[2 * along] * a[1];
                        x[4 * along] += x[2 * along] * a[0] - x[0] * a[2];
                        x[5 * along] += x[0] * a[1] - x[along] * a[0];
                    }
                }
        }
        for (int p = 0; p < N; p++)
            for (int q = 0; q < N; q++) G[p * N + q] += g[p] * g[q];
    }
    for (int i = 0; i < in.rows; i++) {
        const double *c = given + size_t(N) * i, *G = grams.data() + size_t(in.row_joints[i]) * N * N;
        double sum = 0.0;
        for (int p = 0; p < N; p++)
            for (int q = 0; q < N; q++) sum += c[p] * G[p * N + q] * c[q];
        out[i] = sqrt(max(sum, 0.0));
    }
}

class TreeElimination {
  public:
    enum Ending { CLEAR = 0, RANK = 1 };

    int factor(const TreeInput& input) {
        in_ = input;
        m_ = input.joints;
        last_ = input.levels + 1;
        sort_rows();
        sort_children();
        steps_.resize(size_t(m_) * (last_ + 1));
        before_.resize(size_t(m_) * WIDTH);
        tape_.clear();
        slots_.clear();
        free_.clear();
        slot_of_.assign(m_, -1);
        ending_ = CLEAR;
        for (int j = m_ - 1; j >= 0; j--) joint(j);
        return ending_;
    }

    // u := the strict optimum; returns what the held rows leave.
    double solve(const double* values, const double* sides, const double* reference, double* u) {
        left_.resize(size_t(m_) * (last_ + 1) * MOST);
        q_.resize(m_);
        double missed = 0.0;
        for (int j = m_ - 1; j >= 0; j--) {
            const int owner = in_.owner[j];
            for (int level = 0; level <= last_; level++) {
                const Step& step = step_of(j, level);
                double* y = scratch_.data();
                int n = 0;
                for (int child = first_child_[j]; child >= 0; child = next_child_[child]) {
                    const double* given = left(child, level);
                    for (int i = 0; i < step_of(child, level).left; i++) y[n++] = given[i];
                }
                for (int i = step.own; i < step.own_end; i++) y[n++] = sides[sorted_[i]];
                const double* seen = tape_.data() + step.seen;
                if (in_.fixed[j]) {
                    for (int i = 0; i < n; i++) y[i] -= seen[i] * values[j];
                } else if (owner == level) {
                    if (level == last_) y[n++] = reference[j];
                    reflect_values(seen, step.factor, y, n);
                    q_[j] = *y++;
                    n--;
                } else if (owner >= 0 && owner < level) {
                    const double decided = q_[j] / in_.pivot[j];
                    for (int i = 0; i < n; i++) y[i] -= seen[i] * decided;
                    if (level == last_) y[n++] = reference[j] - decided;
                }
                for (int s = 0; s < step.squeezed; s++) reflect_values(squeeze_of(step, s), factor_of(step, s), y, n);
                copy(y, left(j, level), step.left);
            }
            if (in_.parents[j] < 0)
                for (int i = 0; i < step_of(j, 0).left; i++) missed = max(missed, abs(left(j, 0)[i]));
        }
        copy(values, u, m_);
        forwards([&](int j, double by_state) {
            if (!in_.fixed[j]) u[j] = (q_[j] - by_state) / in_.pivot[j];
            return u[j];
        });
        return missed;
    }

    void reduced(int level, const double* gradient, double* out) {
        carried_.assign(size_t(m_) * WIDTH, 0.0);
        for (int j = m_ - 1; j >= 0; j--) {
            double* c = carried_.data() + size_t(j) * WIDTH;
            out[j] = gradient[j] + product(c, in_.axes + size_t(6) * j);
            if (!in_.fixed[j] && in_.owner[j] <= level) {
                out[j] /= in_.pivot[j];
                for (int i = 0; i < 6; i++) c[i] -= out[j] * before(j)[i];
            }
            if (in_.parents[j] < 0) continue;
            double* to = carried_.data() + size_t(in_.parents[j]) * WIDTH;
            const double* a = in_.arms + size_t(3) * j;
            to[0] += c[0] + a[1] * c[5] - a[2] * c[4];
            to[1] += c[1] + a[2] * c[3] - a[0] * c[5];
            to[2] += c[2] + a[0] * c[4] - a[1] * c[3];
            for (int i = 3; i < 6; i++) to[i] += c[i];
        }
    }

    void multipliers(int level, const double* reduced, double* out) {
        left_.resize(size_t(m_) * (last_ + 1) * MOST);
        q_.resize(m_);
        for (int j = 0; j < m_; j++) {
            q_[j] = !in_.fixed[j] && in_.owner[j] < level ? -reduced[j] : 0.0;  // the pull of its row
            if (in_.parents[j] < 0) clear(left(j, 0), size_t(last_ + 1) * MOST);
        }
        std::fill_n(out, in_.rows, 0.0);
        for (int j = 0; j < m_; j++)
            for (int number = level - 1; number >= 0; number--) {
                const Step& step = step_of(j, number);
                const int owner = in_.fixed[j] ? -1 : in_.owner[j];
                const bool decides = owner == number;
                double *all = scratch_.data(), *z = all + decides;
                const int n = step.rows - decides;
                copy(left(j, number), z, step.left);
                clear(z + step.left, n - step.left);
                for (int s = step.squeezed - 1; s >= 0; s--) reflect_values(squeeze_of(step, s), factor_of(step, s), z, n);
                const double* seen = tape_.data() + step.seen;
                if (decides) {
                    all[0] = q_[j];
                    reflect_values(seen, step.factor, all, n + 1);
                } else if (owner >= 0 && owner < number) {
                    double sum = 0.0;
                    for (int i = 0; i < n; i++) sum += seen[i] * z[i];
                    q_[j] -= sum / in_.pivot[j];
                }
                for (int child = first_child_[j]; child >= 0; child = next_child_[child]) {
                    const int count = step_of(child, number).left;
                    copy(all, left(child, number), count);
                    all += count;
                }
                for (int i = step.own; i < step.own_end; i++) out[sorted_[i]] = *all++;
            }
    }

    void displacement(int level, const double* whitened, double* u) {
        forwards([&](int j, double by_state) {
            const bool moves = !in_.fixed[j] && in_.owner[j] <= level;
            return u[j] = moves ? ((in_.owner[j] == level ? whitened[j] : 0.0) - by_state) / in_.pivot[j] : 0.0;
        });
    }

    // How many singular values of a level's rows, as `given` (k, 6), in the directions that the levels above leave, are below
    // `tau`; -1 if one is so near that rounding decides. The inertia of A^T A - tau^2, by the same elimination.
    int count_below(int level, const double* given, double tau) {
        constexpr int ALL = TWIST * TWIST;
        constexpr double NEAR = 1e-10;
        inertia_.assign(size_t(m_) * ALL, 0.0);
        const double square = tau * tau;
        int count = 0;
        for (int j = m_ - 1; j >= 0; j--) {
            double *S = inertia_.data() + size_t(j) * ALL, Sg[TWIST];
            const Step& step = step_of(j, level);
            for (int i = step.own; i < step.own_end; i++) add_square(given + size_t(TWIST) * sorted_[i], 1.0, S);
            const double* g = in_.axes + size_t(TWIST) * j;
            if (!in_.fixed[j]) {
                double along = 0.0;
                for (int a = 0; a < TWIST; a++) along += (Sg[a] = product(S + a * TWIST, g)) * g[a];
                if (in_.owner[j] < level) {  // u = -p.s / rho
                    const double *p = before(j), scale = 1.0 / in_.pivot[j];
                    for (int a = 0; a < TWIST; a++)
                        for (int b = 0; b < TWIST; b++)
                            S[a * TWIST + b] -= scale * (p[a] * Sg[b] + Sg[a] * p[b]);
                    add_square(p, (along - square) * scale * scale, S);
                } else {
                    const double pivot = along - square;
                    if (abs(pivot) <= NEAR * (abs(along) + square)) return -1;
                    count += pivot < 0.0;
                    add_square(Sg, -1.0 / pivot, S);
                }
            }
            if (in_.parents[j] < 0) continue;
            // X^T S X, as for rows, from both sides.
            const double* arm = in_.arms + size_t(3) * j;
            double* to = inertia_.data() + size_t(in_.parents[j]) * ALL;
            double turned[ALL];
            for (int a = 0; a < TWIST; a++) move_row(S + a * TWIST, arm, turned + a * TWIST);
            for (int b = 0; b < TWIST; b++) {
                double column[TWIST], moved[TWIST];
                for (int a = 0; a < TWIST; a++) column[a] = turned[a * TWIST + b];
                move_row(column, arm, moved);
                for (int a = 0; a < TWIST; a++) to[a * TWIST + b] += moved[a];
            }
        }
        return count;
    }

    size_t memory() const {
        return sizeof(double) * (tape_.capacity() + slots_.capacity() + before_.capacity() + left_.capacity() + carried_.capacity()) +
               sizeof(Step) * steps_.capacity();
    }

  private:
    static constexpr int WIDTH = 8;  // of a row
    static constexpr int TWIST = 6;
    static constexpr int MOST = 12;  // rows that are handed on; more are turned into six

    // What was done to one level's rows at one joint.
    struct Step {
        int own, own_end;   // its own rows, in sorted_
        int rows, turned;   // all of them; those that `squeezed` reflectors turned into six
        int left, squeezed;
        double factor;
        size_t seen, squeeze;  // in tape_
    };

    Step& step_of(int j, int level) { return steps_[size_t(j) * (last_ + 1) + level]; }
    double* left(int j, int level) { return left_.data() + (size_t(j) * (last_ + 1) + level) * MOST; }
    double* before(int j) { return before_.data() + size_t(j) * WIDTH; }
    double* slot(int j, int level) { return slots_.data() + (size_t(slot_of_[j]) * (last_ + 1) + level) * MOST * WIDTH; }
    double& size_of(int j, int level) { return sizes_[size_t(j) * (last_ + 1) + level]; }
    const double* squeeze_of(const Step& step, int s) const { return tape_.data() + step.squeeze + size_t(s) * (step.turned + 1) + 1; }
    double factor_of(const Step& step, int s) const { return tape_[step.squeeze + size_t(s) * (step.turned + 1)]; }

    static double product(const double* row, const double* axis) {
        double sum = 0.0;
        for (int i = 0; i < TWIST; i++) sum += row[i] * axis[i];
        return sum;
    }

    // S += factor x x^T
    static void add_square(const double* x, double factor, double* S) {
        for (int a = 0; a < TWIST; a++)
            for (int b = 0; b < TWIST; b++) S[a * TWIST + b] += factor * x[a] * x[b];
    }

    static void move_row(const double* row, const double* a, double* to) {
        to[0] = row[0] + a[1] * row[5] - a[2] * row[4];
        to[1] = row[1] + a[2] * row[3] - a[0] * row[5];
        to[2] = row[2] + a[0] * row[4] - a[1] * row[3];
        to[3] = row[3], to[4] = row[4], to[5] = row[5];
    }

    static void reflect_values(const double* v, double factor, double* y, int n) {
        double sum = 0.0;
        for (int i = 0; i < n; i++) sum += v[i] * y[i];
        sum *= factor;
        for (int i = 0; i < n; i++) y[i] -= sum * v[i];
    }

    // rows (n) := (I - factor v v^T) rows
    static void reflect_rows(const double* v, double factor, double* rows, int n) {
        Four a = {}, b = {};
        for (int i = 0; i < n; i++) {
            const Four x = {v[i], v[i], v[i], v[i]};
            a += x * four(rows + i * WIDTH);
            b += x * four(rows + i * WIDTH + LANES);
        }
        const Four f = {factor, factor, factor, factor};
        a *= f;
        b *= f;
        for (int i = 0; i < n; i++) {
            const Four x = {v[i], v[i], v[i], v[i]};
            four(rows + i * WIDTH) -= x * a;
            four(rows + i * WIDTH + LANES) -= x * b;
        }
    }

    static double length(const double* rows, int n) { return norm(rows, n * WIDTH); }

    // Own rows of each joint and level, in sorted_ from own_[j * (last_ + 1) + level] on.
    void sort_rows() {
        const size_t bins = size_t(m_) * (last_ + 1);
        own_.assign(bins + 1, 0);
        for (int i = 0; i < in_.rows; i++)
            if (in_.counts[i]) own_[size_t(in_.row_joints[i]) * (last_ + 1) + in_.row_levels[i] + 1]++;
        for (size_t b = 0; b < bins; b++) own_[b + 1] += own_[b];
        sorted_.resize(own_[bins]);
        next_own_.assign(own_.begin(), own_.end() - 1);
        for (int i = 0; i < in_.rows; i++)
            if (in_.counts[i]) sorted_[next_own_[size_t(in_.row_joints[i]) * (last_ + 1) + in_.row_levels[i]]++] = i;
    }

    // The joints that each one carries, the last one first.
    void sort_children() {
        first_child_.assign(m_, -1);
        last_child_.assign(m_, -1);
        next_child_.assign(m_, -1);
        most_rows_ = 0;
        std::vector<int>& children = next_own_;  // how many
        children.assign(m_, 0);
        for (int j = m_ - 1; j >= 0; j--) {
            const int parent = in_.parents[j];
            if (parent < 0) continue;
            children[parent]++;
            (first_child_[parent] < 0 ? first_child_[parent] : next_child_[last_child_[parent]]) = j;
            last_child_[parent] = j;
        }
        for (int j = 0; j < m_; j++)
            most_rows_ = max(most_rows_, MOST * children[j] + own_[size_t(j + 1) * (last_ + 1)] - own_[size_t(j) * (last_ + 1)] + 2);
        rows_.resize(size_t(most_rows_) * WIDTH);
        scratch_.resize(most_rows_ + 2);
        sizes_.resize(size_t(m_) * (last_ + 1));
    }

    void joint(int j) {
        const double* axis = in_.axes + size_t(TWIST) * j;
        const double length_of_axis = sqrt(product(axis, axis));
        const bool fixed = in_.fixed[j];
        in_.owner[j] = -1;
        in_.pivot[j] = 1.0;
        clear(before(j), WIDTH);
        take_slot(j);
        for (int level = 0; level <= last_; level++) {
            Step& step = step_of(j, level);
            double *c = rows_.data(), size = 0.0;
            int n = gather(j, level, step, size);
            size = max(size, length(c, n));
            step.seen = tape_.size();
            step.factor = 0.0;
            for (int i = 0; i < n; i++) tape_.push_back(product(c + i * WIDTH, axis));
            const int owner = in_.owner[j];
            if (!fixed && owner >= 0) {
                substitute(j, step, c, n);
                size = max(size, length(c, n));
                if (level == last_) {
                    double* added = c + n++ * WIDTH;
                    for (int i = 0; i < WIDTH; i++) added[i] = -before(j)[i] / in_.pivot[j];
                    size = max(size, length(added, 1));
                }
            } else if (!fixed && level == last_) {
                tape_.push_back(1.0);
                clear(c + n++ * WIDTH, WIDTH);
                decide(j, level, step, c, n);
            } else if (!fixed && n && is_felt(tape_.data() + step.seen, n, size * length_of_axis)) {
                decide(j, level, step, c, n);
            }
            if (!fixed && in_.owner[j] == level) {
                c += WIDTH;
                n--;
            }
            step.rows = n + (!fixed && in_.owner[j] == level);
            step.turned = n;
            step.squeezed = 0;
            step.squeeze = tape_.size();
            step.left = n > MOST ? squeeze(step, c, n, in_.zero * size) : n;
            size_of(j, level) = size;
            hand_on(j, level, c, step.left);
        }
        for (int child = first_child_[j]; child >= 0; child = next_child_[child]) free_.push_back(slot_of_[child]);
    }

    // rows_ := what the joints carried hand on, then the joint's own rows; returns how many.
    int gather(int j, int level, Step& step, double& size) {
        double* to = rows_.data();
        int n = 0;
        for (int child = first_child_[j]; child >= 0; child = next_child_[child]) {
            const int count = step_of(child, level).left;
            copy(slot(child, level), to + size_t(n) * WIDTH, size_t(count) * WIDTH);
            n += count;
            size = max(size, size_of(child, level));
        }
        step.own = own_[size_t(j) * (last_ + 1) + level];
        step.own_end = own_[size_t(j) * (last_ + 1) + level + 1];
        for (int i = step.own; i < step.own_end; i++, n++) {
            copy(in_.covectors + size_t(TWIST) * sorted_[i], to + size_t(n) * WIDTH, TWIST);
            clear(to + size_t(n) * WIDTH + TWIST, WIDTH - TWIST);
        }
        return n;
    }

    bool is_felt(const double* seen, int n, double size) {
        const double felt = norm(seen, n);
        if (felt > in_.zero * size && felt <= in_.clear * size) ending_ = RANK;
        return felt > in_.clear * size;
    }

    // Lets `level` decide joint j: its rows (n) become rho u + p.s = q, the first, and rows without u.
    void decide(int j, int level, Step& step, double* c, int n) {
        double* v = tape_.data() + step.seen;
        in_.pivot[j] = reflector(v, v, n, step.factor);
        reflect_rows(v, step.factor, c, n);
        in_.owner[j] = level;
        copy(c, before(j), WIDTH);
    }

    // Puts u = (q - p.s) / rho in place of u.
    void substitute(int j, const Step& step, double* c, int n) {
        const double *seen = tape_.data() + step.seen, scale = 1.0 / in_.pivot[j];
        for (int i = 0; i < n; i++) add(-seen[i] * scale, before(j), c + i * WIDTH, WIDTH);
    }

    // At most six rows that say what `n` rows say; those up to `zero` in length say nothing.
    int squeeze(Step& step, double* c, int n, double zero) {
        bool used[WIDTH] = {};
        int done = 0;
        for (; done < min(n, TWIST); done++) {
            Four a = {}, b = {};
            for (int i = done; i < n; i++) {
                a += four(c + i * WIDTH) * four(c + i * WIDTH);
                b += four(c + i * WIDTH + LANES) * four(c + i * WIDTH + LANES);
            }
            int best = -1;
            double most = zero * zero;
            for (int k = 0; k < TWIST; k++) {
                const double square = k < LANES ? a[k] : b[k - LANES];
                if (!used[k] && square > most) most = square, best = k;
            }
            if (best < 0) break;
            used[best] = true;
            const size_t at = tape_.size();
            tape_.resize(at + n + 1, 0.0);
            double* v = tape_.data() + at + 1;
            for (int i = 0; i < done; i++) v[i] = 0.0;
            for (int i = done; i < n; i++) v[i] = c[i * WIDTH + best];
            reflector(v + done, v + done, n - done, tape_[at]);
            reflect_rows(v + done, tape_[at], c + done * WIDTH, n - done);
            for (int i = done + 1; i < n; i++) c[i * WIDTH + best] = 0.0;
            step.squeezed++;
        }
        return done;
    }

    // Rows on the joint's twist become rows on that of the joint before.
    void hand_on(int j, int level, const double* c, int n) {
        const double* a = in_.arms + size_t(3) * j;
        double* to = slot(j, level);
        copy(c, to, size_t(n) * WIDTH);
        if (a[0] == 0.0 && a[1] == 0.0 && a[2] == 0.0) return;
        for (int i = 0; i < n; i++) {
            double *row = to + i * WIDTH, *force = row + 3;
            row[0] += a[1] * force[2] - a[2] * force[1];
            row[1] += a[2] * force[0] - a[0] * force[2];
            row[2] += a[0] * force[1] - a[1] * force[0];
        }
    }

    void take_slot(int j) {
        if (free_.empty()) {
            free_.push_back(int(slots_.size() / (size_t(last_ + 1) * MOST * WIDTH)));
            slots_.resize(slots_.size() + size_t(last_ + 1) * MOST * WIDTH);
        }
        slot_of_[j] = free_.back();
        free_.pop_back();
    }

    // From the base to the tips: `move` returns a joint's step, given p.s.
    template <class Move> void forwards(Move move) {
        carried_.resize(size_t(m_) * WIDTH);
        for (int j = 0; j < m_; j++) {
            double* s = carried_.data() + size_t(j) * WIDTH;
            const int parent = in_.parents[j];
            if (parent < 0) {
                clear(s, WIDTH);
            } else {
                const double *a = in_.arms + size_t(3) * j, *w = carried_.data() + size_t(parent) * WIDTH;
                s[0] = w[0], s[1] = w[1], s[2] = w[2];
                s[3] = w[3] + w[1] * a[2] - w[2] * a[1];
                s[4] = w[4] + w[2] * a[0] - w[0] * a[2];
                s[5] = w[5] + w[0] * a[1] - w[1] * a[0];
            }
            const double u = move(j, product(before(j), s));
            const double* axis = in_.axes + size_t(TWIST) * j;
            for (int i = 0; i < TWIST; i++) s[i] += u * axis[i];
        }
    }

    TreeInput in_{};
    int m_ = 0, last_ = 0, most_rows_ = 0, ending_ = CLEAR;
    std::vector<Step> steps_;
    std::vector<double> tape_, slots_, rows_, scratch_, sizes_, before_, left_, q_, carried_, inertia_;
    std::vector<int> own_, next_own_, sorted_, first_child_, last_child_, next_child_, slot_of_, free_;
};

}  // namespace prioritized_ik
