// Strict levels of a kinematic tree: solvers/tree/elimination.py, which says what and why; names are the same.
#pragma once

#include "exchange.hpp"
#include "tree_damped.hpp"
#include "tree_level.hpp"
#include "tree_motions.hpp"

namespace prioritized_ik {

class TreeElimination {
  public:
    enum Clarity { CLEAR = 0, UNCLEAR = 1 };

    // Takes a problem's tree and rows; what the caller owns must stay where it is.
    void pose(const TreeInput& input) {
        in_ = input;
        stages_.build(in_);
        levels_.resize(in_.levels + 1);
        used_.reserve(in_.levels + 1);
    }

    int factor() {
        used_.clear();
        for (Level& level : levels_) level.sorted.clear(), level.rank = 0;
        for (int i = 0; i < in_.rows; i++)
            if (stages_.real[i] && in_.counts[i]) levels_[in_.row_levels[i]].sorted.push_back(i);
        bool clear = true;
        inputs_ = 0;
        for (int i = 0; i < in_.joints; i++) inputs_ += !in_.fixed[i];
        int left = inputs_;
        for (int number = 0; number <= in_.levels; number++) {
            Level& level = levels_[number];
            in_.ranks[number] = 0;
            in_.strongest[number] = 0.0, in_.weakest[number] = INFINITE;
            if (level.sorted.empty()) continue;
            sort(level);
            if (used_.empty()) level.start(in_, stages_);
            else level.start(levels_[used_.back()], in_, stages_);
            level.factor(in_, stages_);
            used_.push_back(number);
            left -= level.rank;
            in_.ranks[number] = level.rank;
            in_.strongest[number] = level.strongest, in_.weakest[number] = level.weakest;
            clear = clear && (level.rank == 0 || level.weakest > in_.noise * level.strongest);
        }
        left_ = left;
        return clear ? CLEAR : UNCLEAR;
    }

    // u := the strict optimum
    void solve(const double* values, const double* sides, const double* reference, double* u) {
        const int m = in_.joints;
        bool moves = false;
        for (int j = 0; j < m; j++) {
            u[j] = in_.fixed[j] ? values[j] : 0.0;
            moves = moves || u[j] != 0.0;
        }
        missing_.resize(in_.rows);
        for (int number : used_) {
            Level& level = levels_[number];
            missing(level, sides, moves ? u : nullptr);
            q_.resize(level.rank), e_.resize(level.rank);
            level.from_sides(missing_.data(), q_.data());
            level.solve(q_.data(), e_.data());
            join(number, e_.data(), nullptr, u);
            moves = true;
        }
        bool wanted = false;
        for (int j = 0; j < m; j++) wanted = wanted || (reference[j] != 0.0 && !in_.fixed[j]);
        if (!wanted) return;  // what levels decide has no part in what they leave
        step_.resize(m);
        for (int j = 0; j < m; j++) step_[j] = reference[j] - u[j];
        parts_.resize(inputs_);
        parts(step_.data(), parts_.data());
        if (used_.empty()) join(-1, nullptr, parts_.data(), u);
        else join(used_.back(), nullptr, parts_.data() + inputs_ - left_, u);
    }

    void motions(const double* u, double* motions, double* sizes) const { prioritized_ik::motions(in_, u, motions, sizes); }

    void damp(const double* row_weights, const double* joint_weights) { damped_.factor(stages_, row_weights, joint_weights); }
    void damped(const double* row_sides, const double* joint_sides, double* u) { damped_.solve(row_sides, joint_sides, u); }

    // out := a gradient (m) in the coordinates of each level, then of what all leave; of a last level only, returns where it is.
    const double* parts(const double* gradient, double* out, int last = -1) {
        inputs_of(gradient);
        for (int number : used_) {
            Level& level = levels_[number];
            f_.resize(level.inputs - level.rank);
            level.split(z_.data(), out, f_.data());
            if (number == last) return out;
            out += level.rank;
            z_.swap(f_);
        }
        copy(z_.data(), out, left_);
        return out;
    }

    // u (m) := what of a step v (m) the levels up to one leave
    void left_by(int number, const double* v, double* u) {
        const int m = in_.joints;
        clear(u, m);
        inputs_of(v);
        int last = -1;
        for (int used : used_) {
            if (used > number) break;
            Level& level = levels_[last = used];
            parts_.resize(inputs_ + 1), f_.resize(level.inputs - level.rank);
            level.split(z_.data(), parts_.data(), f_.data());
            z_.swap(f_);
        }
        parts_.assign(z_.begin(), z_.end());  // join works in z_
        join(last, nullptr, parts_.data(), u);
    }

    void whitened(int number, const double* part, double* out) {
        if (levels_[number].rank) levels_[number].whiten(part, out);
    }

    void pulls(int number, const double* whitened, double* out) {
        clear(out, in_.rows);
        if (levels_[number].rank) levels_[number].pulls(whitened, out);
    }

    void displacement(int number, const double* whitened, double* u) {
        clear(u, in_.joints);
        if (!levels_[number].rank) return;
        e_.resize(levels_[number].rank);
        levels_[number].solve(whitened, e_.data());
        join(number, e_.data(), nullptr, u);
    }

    // What `Factors.balance` returns, but for arrays.
    struct Balance {
        double lower, moved, astray, noise, feigned, of_rows;
    };

    // See `Factors.balance`: given (k) or (m), sizes (k) or (m), off (m) in and out, rest (m), pulls (k), of_bounds (m).
    Balance balance(int number, const double* given, const double* sizes, double rounded, bool is_held, double* off, double* rest,
                    double* values, double* of_bounds) {
        const int m = in_.joints, k = in_.rows;
        const bool is_last = number > in_.levels;
        Balance out{};
        if (is_last) copy(given, rest, m);
        else torques(number, given, -1.0, rest);
        clear(values, k);
        pulls_.resize(k), noise_.resize(m), blur_.resize(m), parts_.resize(inputs_ + 1), white_.resize(inputs_ + 1);
        for (size_t i = used_.size(); i-- > 0;) {
            const int above = used_[i];
            if (above >= number || !in_.ranks[above]) continue;
            const double* own = parts(rest, parts_.data(), above);
            levels_[above].whiten(own, white_.data());
            levels_[above].pulls(white_.data(), pulls_.data());
            for (int row : levels_[above].sorted) values[row] = pulls_[row] = -pulls_[row];
            torques(above, pulls_.data(), 1.0, rest, true);
        }
        for (int i = 0; i < k; i++) pulls_[i] = abs(values[i]) + (is_last ? 0.0 : sizes[i]);
        sizes_of_torques(pulls_.data(), noise_.data());
        for (int j = 0; j < m; j++) noise_[j] = rounded * (noise_[j] + (is_last ? sizes[j] : 0.0));
        out.noise = norm(noise_.data(), m);
        const int rank = is_last ? left_ : in_.ranks[number];
        int first = is_last ? inputs_ - left_ : 0;  // place of the level's own part
        for (int above = 0; above < number && !is_last; above++) first += in_.ranks[above];
        double mine = 0.0, others = 0.0;
        const auto count = [&](int i, double one) { (i < first || i >= first + rank ? others : mine) += one * one; };
        if (is_last) {
            parts(rest, parts_.data());
            for (int i = 0; i < inputs_; i++) count(i, parts_[i]);
            out.lower = mine;
            out.moved = sqrt(mine);
            copy(off, blur_.data(), m);
        } else {
            // What the rest could lower goes side by side with what its rounding can feign.
            step_.resize(m);
            for (int j = 0; j < m; j++) step_[j] = (j * 7919 % 13 < 6 ? 1.0 : -1.0) * noise_[j];
            Two* both = parts_of_both(rest, step_.data());
            for (int i = 0; i < inputs_; i++) count(i, both[i][0]);
            clear(blur_.data(), m), clear(step_.data(), m);
            if (rank) {
                Two* white = room(both_white_, rank);
                levels_[number].whiten(both + first, white);
                for (int i = 0; i < rank; i++) out.lower += white[i][0] * white[i][0];
                Two* moved = room(both_parts_, rank);
                levels_[number].solve(white, moved);
                join_both(number, moved, blur_.data(), step_.data());
            }
            out.moved = norm(blur_.data(), m);
            out.feigned = norm(step_.data(), m);
            for (int j = 0; j < m; j++) off[j] += blur_[j];
            stages_.twists(off, twists_);
            for (int row : levels_[number].sorted)
                pulls_[row] = in_.roots[row] * product(stages_.row(row), twist_of(row));
            torques(number, pulls_.data(), 1.0, blur_.data());
        }
        out.astray = sqrt(others);
        for (int j = 0; j < m; j++) noise_[j] += abs(blur_[j]);
        if (is_last) out.feigned = norm(noise_.data(), m);
        copy(noise_.data(), of_bounds, m);
        if (!is_held) return out;
        for (int j = 0; j < m; j++) step_[j] = blur_[j] < 0.0 ? -noise_[j] : noise_[j];
        std::fill(pulls_.begin(), pulls_.end(), 0.0);
        int lowest = -1;  // of the levels above
        for (int above : used_)
            if (above < number) lowest = above;
        if (lowest >= 0) parts(step_.data(), parts_.data(), lowest);
        const double* own = parts_.data();
        for (int above : used_) {
            if (above >= number) break;
            if (in_.ranks[above]) {
                levels_[above].whiten(own, white_.data());
                levels_[above].pulls(white_.data(), pulls_.data());
                const std::vector<int>& rows = levels_[above].sorted;
                double square = 0.0;
                for (int row : rows) square += pulls_[row] * pulls_[row];
                for (int row : rows) pulls_[row] = abs(pulls_[row]) + sqrt(square / double(rows.size()));
            }
            own += in_.ranks[above];
        }
        for (int i = 0; i < k; i++)
            if (in_.row_levels[i] == 0) out.of_rows = max(out.of_rows, pulls_[i]);
        sizes_of_torques(pulls_.data(), noise_.data());
        for (int j = 0; j < m; j++) of_bounds[j] += noise_[j];
        return out;
    }

    int count_below(int number, double tau) const {
        if (!levels_[number].sorted.empty()) return levels_[number].count_below(in_, tau);
        int left = inputs_;
        for (int above = 0; above < number; above++) left -= in_.ranks[above];
        return left;
    }

    // Largest singular value of a level's rows, without weights, from below: see `PosedOnTree.norm_of_matrix`.
    double norm_of_matrix(int number) {
        constexpr int POWERS = 30;  // of posed.py
        std::vector<double> u(in_.joints), moved(in_.rows, 0.0);
        double largest = 0.0;
        for (int row : levels_[number].sorted) moved[row] = in_.lengths[row] / in_.roots[row];
        for (int turn = 0; turn < POWERS; turn++) {
            torques(number, moved.data(), 1.0, u.data());
            const double size = norm(u.data(), in_.joints);
            if (size == 0.0) return 0.0;
            for (double& one : u) one /= size;
            stages_.twists(u.data(), twists_);
            double square = 0.0;
            for (int row : levels_[number].sorted) {
                const double felt = product(stages_.row(row), twist_of(row));
                moved[row] = felt / in_.roots[row];
                square += felt * felt;
            }
            largest = sqrt(square);
        }
        return largest;
    }

    int inputs() const { return inputs_; }

    size_t memory() const {
        size_t sum = sizeof(double) * (stages_.axes.capacity() + stages_.spread.capacity()) + sizeof(Stage) * stages_.all.capacity();
        for (const Level& level : levels_) sum += level.memory();
        return sum + damped_.memory();
    }

  private:
    void sort(Level& level) const {
        const auto before = [&](int a, int b) { return stages_.of_row[a] < stages_.of_row[b]; };
        if (!std::is_sorted(level.sorted.begin(), level.sorted.end(), before))
            std::stable_sort(level.sorted.begin(), level.sorted.end(), before);
    }

    const double* twist_of(int row) const { return twists_.data() + size_t(TWIST) * stages_.of_row[row]; }

    // out (m) := factor times the torques of a level's weighted rows times values (k), or added to it
    void torques(int number, const double* values, double factor, double* out, bool added = false) {
        wrenches_.assign(stages_.all.size() * TWIST, 0.0);
        for (int row : levels_[number].sorted) {
            const double value = factor * in_.roots[row] * values[row], *c = stages_.row(row);
            double* to = wrenches_.data() + size_t(TWIST) * stages_.of_row[row];
            for (int i = 0; i < TWIST; i++) to[i] += value * c[i];
        }
        for (size_t n = stages_.all.size(); n-- > 0;) {
            const Stage& stage = stages_.all[n];
            const double* wrench = wrenches_.data() + n * TWIST;
            for (int i = 0; i < stage.count; i++) {
                const double torque = product(wrench, stages_.axis(stage, i));
                double& to = out[stages_.joints[stage.joints + i]];
                to = added ? to + torque : torque;
            }
            if (stage.before == BASE) continue;
            double moved[TWIST], *before = wrenches_.data() + size_t(TWIST) * stage.before;
            move_row(wrench, stage.arm, moved);
            for (int i = 0; i < TWIST; i++) before[i] += moved[i];
        }
    }

    // out (m) := the sum of the sizes of all terms of the torques of all weighted rows times values (k)
    void sizes_of_torques(const double* values, double* out) {
        wrenches_.assign(stages_.all.size() * TWIST, 0.0);
        for (int row = 0; row < in_.rows; row++) {
            if (values[row] == 0.0) continue;
            const double value = in_.roots[row] * values[row], *c = stages_.row(row);
            double* to = wrenches_.data() + size_t(TWIST) * stages_.of_row[row];
            for (int i = 0; i < TWIST; i++) to[i] += abs(value * c[i]);
        }
        for (size_t n = stages_.all.size(); n-- > 0;) {
            const Stage& stage = stages_.all[n];
            const double* sizes = wrenches_.data() + n * TWIST;
            for (int i = 0; i < stage.count; i++) {
                const double* g = stages_.axis(stage, i);
                double sum = 0.0;
                for (int k = 0; k < TWIST; k++) sum += abs(g[k]) * sizes[k];
                out[stages_.joints[stage.joints + i]] = sum;
            }
            if (stage.before == BASE) continue;
            double* to = wrenches_.data() + size_t(TWIST) * stage.before;
            const double *a = stage.arm, x = abs(a[0]), y = abs(a[1]), z = abs(a[2]);
            to[0] += sizes[0] + y * sizes[5] + z * sizes[4];
            to[1] += sizes[1] + z * sizes[3] + x * sizes[5];
            to[2] += sizes[2] + x * sizes[4] + y * sizes[3];
            for (int i = 3; i < TWIST; i++) to[i] += sizes[i];
        }
    }

    // missing_ := what a level's rows lack at u, or at rest
    void missing(const Level& level, const double* sides, const double* u) {
        if (u) stages_.twists(u, twists_);
        for (int row : level.sorted) {
            const double* s = u ? twist_of(row) : nullptr;
            missing_[row] = sides[row] - (s ? in_.roots[row] * product(stages_.row(row), s) : 0.0);
        }
    }

    // z_ := inputs of the first frame
    void inputs_of(const double* gradient) {
        z_.resize(inputs_);
        int at = 0;
        for (int j : stages_.joints)
            if (!in_.fixed[j]) z_[at++] = gradient[j];
    }

    // u += the step of a level's coordinates, and of those of what it leaves; zero where null
    void join(int number, const double* e, const double* f, double* u) {
        const double* z = f;
        for (size_t k = used_.size(); k-- > 0;) {
            if (used_[k] > number) continue;
            Level& level = levels_[used_[k]];
            std::vector<double>& made = k % 2 ? f_ : z_;
            made.resize(level.inputs);
            level.join(used_[k] == number ? e : nullptr, static_cast<const double*>(z), made.data());
            z = made.data();
        }
        int at = 0;
        for (int j : stages_.joints)
            if (!in_.fixed[j]) u[j] += z[at++];
    }

    static Two* room(std::vector<double>& memory, int count) {
        memory.resize(max(memory.size(), size_t(2) * count));
        return reinterpret_cast<Two*>(memory.data());
    }

    // Two gradients in the coordinates of each level, then of what all leave, see `parts`.
    Two* parts_of_both(const double* a, const double* b) {
        Two *out = room(both_parts_, inputs_), *z = room(both_z_, inputs_), *f = room(both_f_, inputs_), *to = out;
        int at = 0;
        for (int j : stages_.joints)
            if (!in_.fixed[j]) z[at++] = Two{a[j], b[j]};
        for (int number : used_) {
            levels_[number].split(z, to, f);
            to += levels_[number].rank;
            std::swap(z, f);
        }
        copy_few(z, to, left_);
        return out;
    }

    // a, b += the steps of a level's coordinates, two at once; see `join`.
    void join_both(int number, const Two* e, double* a, double* b) {
        Two *made = room(both_z_, inputs_), *z = nullptr, *other = room(both_f_, inputs_);
        for (size_t k = used_.size(); k-- > 0;) {
            if (used_[k] > number) continue;
            levels_[used_[k]].join(used_[k] == number ? e : nullptr, static_cast<const Two*>(z), made);
            z = made;
            std::swap(made, other);
        }
        int at = 0;
        for (int j : stages_.joints)
            if (!in_.fixed[j]) a[j] += z[at][0], b[j] += z[at][1], at++;
    }

    TreeInput in_{};
    Stages stages_;
    Damped damped_;
    std::vector<Level> levels_;
    std::vector<int> used_;  // the levels that have rows
    int inputs_ = 0, left_ = 0;
    std::vector<double> both_parts_, both_white_, both_z_, both_f_;
    std::vector<double> q_, e_, z_, f_, missing_, twists_, step_, parts_, pulls_, noise_, blur_, white_, wrenches_;
};

}  // namespace prioritized_ik
