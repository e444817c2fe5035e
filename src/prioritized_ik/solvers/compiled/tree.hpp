// Strict levels of a kinematic tree: solvers/tree/elimination.py, which says what and why; names are the same.
#pragma once

#include "tree_level.hpp"

namespace prioritized_ik {

class TreeElimination {
  public:
    enum Ending { CLEAR = 0, RANK = 1 };

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
            in_.strongest[number] = 0.0;
            if (level.sorted.empty()) continue;
            sort(level);
            if (used_.empty()) level.start(in_, stages_);
            else level.start(levels_[used_.back()]);
            level.factor(in_, stages_);
            used_.push_back(number);
            left -= level.rank;
            in_.ranks[number] = level.rank;
            in_.strongest[number] = level.strongest;
            clear = clear && (level.rank == 0 || level.weakest > in_.noise * level.strongest);
        }
        left_ = left;
        return clear ? CLEAR : RANK;
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

    // out := a gradient (m) in the coordinates of each level, then of what all leave.
    void parts(const double* gradient, double* out) {
        inputs_of(gradient);
        for (int number : used_) {
            Level& level = levels_[number];
            f_.resize(level.inputs - level.rank);
            level.split(z_.data(), out, f_.data());
            out += level.rank;
            z_.swap(f_);
        }
        copy(z_.data(), out, left_);
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

    int count_below(int number, double tau) const {
        if (!levels_[number].sorted.empty()) return levels_[number].count_below(in_, tau);
        int left = inputs_;
        for (int above = 0; above < number; above++) left -= in_.ranks[above];
        return left;
    }

    size_t memory() const {
        size_t sum = sizeof(double) * (stages_.axes.capacity() + stages_.spread.capacity()) + sizeof(Stage) * stages_.all.capacity();
        for (const Level& level : levels_) sum += level.memory();
        return sum;
    }

  private:
    void sort(Level& level) const {
        const auto before = [&](int a, int b) { return stages_.of_joint[in_.row_joints[a]] < stages_.of_joint[in_.row_joints[b]]; };
        if (!std::is_sorted(level.sorted.begin(), level.sorted.end(), before))
            std::stable_sort(level.sorted.begin(), level.sorted.end(), before);
    }

    // missing_ := what a level's rows lack at u, or at rest
    void missing(const Level& level, const double* sides, const double* u) {
        if (u) stages_.twists(u, twists_);
        for (int row : level.sorted) {
            const double* s = u ? twists_.data() + size_t(TWIST) * stages_.of_joint[in_.row_joints[row]] : nullptr;
            missing_[row] = sides[row] - (s ? in_.roots[row] * product(in_.given + size_t(TWIST) * row, s) : 0.0);
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
            level.join(used_[k] == number ? e : nullptr, z, made.data());
            z = made.data();
        }
        int at = 0;
        for (int j : stages_.joints)
            if (!in_.fixed[j]) u[j] += z[at++];
    }

    TreeInput in_{};
    Stages stages_;
    std::vector<Level> levels_;
    std::vector<int> used_;  // the levels that have rows
    int inputs_ = 0, left_ = 0;
    std::vector<double> q_, e_, z_, f_, missing_, twists_, step_, parts_;
};

}  // namespace prioritized_ik
