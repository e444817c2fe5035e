// Least squares of rows and joints together, by one sweep: solvers/tree/damped.py, which says what and why; names are the same.
#pragma once

#include "tree_stages.hpp"

namespace prioritized_ik {

class Damped {
  public:
    // row_weights (k), joint_weights (m)
    void factor(const Stages& stages, const double* row_weights, const double* joint_weights) {
        stages_ = &stages;
        connect();
        tape_.clear(), roots_.clear(), handed_.clear();
        for (size_t n = steps_.size(); n-- > 0;) factor(int(n), row_weights, joint_weights);
    }

    // u (m) := the least squares of weighted right-hand sides (k) and (m)
    void solve(const double* row_sides, const double* joint_sides, double* u) {
        values_.resize(steps_.size() * TWIST), found_.resize(stages_->joints.size());
        for (size_t n = steps_.size(); n-- > 0;) turn(int(n), row_sides, joint_sides);
        twists_.resize(steps_.size() * TWIST);
        for (size_t n = 0; n < steps_.size(); n++) substitute(int(n), u);
    }

    size_t memory() const {
        return sizeof(double) * (tape_.capacity() + roots_.capacity() + handed_.capacity() + rows_.capacity()) +
               sizeof(Step) * steps_.capacity();
    }

  private:
    struct Step {
        int first, next;             // stages that it carries, as a list
        int own, own_end;            // its rows in sorted_
        int rows, handed;            // all that meet here, and those that are handed on
        size_t tape, root, handed_at;
    };

    static int width(int count) { return (count + TWIST + LANES - 1) / LANES * LANES; }

    void connect() {
        const std::vector<Stage>& all = stages_->all;
        steps_.assign(all.size(), Step{-1, -1, 0, 0, 0, 0, 0, 0, 0});
        for (size_t n = 0; n < all.size(); n++)
            if (all[n].before != BASE) {
                steps_[n].next = steps_[all[n].before].first;
                steps_[all[n].before].first = int(n);
            }
        std::vector<int> ends(all.size() + 1, 0);
        for (int n : stages_->of_row) ends[n + 1]++;
        for (size_t n = 0; n < all.size(); n++) {
            steps_[n].own = steps_[n].own_end = ends[n];
            ends[n + 1] += ends[n];
        }
        sorted_.resize(stages_->of_row.size());
        for (size_t row = 0; row < sorted_.size(); row++) sorted_[steps_[stages_->of_row[row]].own_end++] = int(row);
    }

    // Calls back with each row on the stage's twist: handed on by those it carries, then its own (`row` is its number, or -1).
    template <class Do> void for_rows(const Step& step, Do what) const {
        for (int c = step.first; c >= 0; c = steps_[c].next)
            for (int i = 0; i < steps_[c].handed; i++) what(c, i, -1);
        for (int i = step.own; i < step.own_end; i++) what(-1, 0, sorted_[i]);
    }

    void factor(int n, const double* row_weights, const double* joint_weights) {
        const Stage& stage = stages_->all[n];
        Step& step = steps_[n];
        const int count = stage.count, w = width(count);
        step.rows = step.own_end - step.own + count;
        for (int c = step.first; c >= 0; c = steps_[c].next) step.rows += steps_[c].handed;
        rows_.assign(size_t(step.rows) * w, 0.0);
        double* to = rows_.data();
        for_rows(step, [&](int child, int i, int row) {
            double weighted[TWIST];
            const double* given = row < 0 ? handed_.data() + steps_[child].handed_at + i * TWIST : weighted;
            if (row >= 0)
                for (int k = 0; k < TWIST; k++) weighted[k] = row_weights[row] * stages_->row(row)[k];
            for (int j = 0; j < count; j++) to[j] = product(given, stages_->axis(stage, j));
            move_row(given, stage.arm, to + count);
            to += w;
        });
        for (int j = 0; j < count; j++, to += w) to[j] = joint_weights[stages_->joints[stage.joints + j]];
        step.tape = tape_.size();
        for (int j = 0; j < count; j++) reflect_rows(j, step.rows, w);
        step.root = roots_.size();
        roots_.insert(roots_.end(), rows_.begin(), rows_.begin() + size_t(count) * w);
        step.handed_at = handed_.size();
        step.handed = stage.before == BASE ? 0 : min(TWIST, step.rows - count);
        for (int j = 0; j < step.handed; j++) reflect_rows(count + j, step.rows, w);
        for (int j = 0; j < step.handed; j++) {
            const double* from = rows_.data() + size_t(count + j) * w + count;
            handed_.insert(handed_.end(), from, from + TWIST);
        }
    }

    // Turns rows from `first` on so that only it has anything in the column of its number.
    void reflect_rows(int first, int end, int w) {
        const int n = end - first;
        const size_t at = tape_.size();
        tape_.resize(at + n + 1);
        double *v = tape_.data() + at + 1, *rows = rows_.data() + size_t(first) * w;
        for (int i = 0; i < n; i++) v[i] = rows[size_t(i) * w + first];
        const double beta = reflector(v, v, n, tape_[at]), tau = tape_[at];
        for (int k = first / LANES * LANES; k < w; k += LANES) {
            Four sum = {};
            for (int i = 0; i < n; i++) sum += Four{v[i], v[i], v[i], v[i]} * four(rows + size_t(i) * w + k);
            sum *= Four{tau, tau, tau, tau};
            for (int i = 0; i < n; i++) four(rows + size_t(i) * w + k) -= Four{v[i], v[i], v[i], v[i]} * sum;
        }
        rows[first] = beta;
        for (int i = 1; i < n; i++) rows[size_t(i) * w + first] = 0.0;
    }

    void turn(int n, const double* row_sides, const double* joint_sides) {
        const Stage& stage = stages_->all[n];
        const Step& step = steps_[n];
        rows_.resize(step.rows);
        double *y = rows_.data(), *to = y;
        for_rows(step, [&](int child, int i, int row) { *to++ = row < 0 ? values_[size_t(TWIST) * child + i] : row_sides[row]; });
        for (int j = 0; j < stage.count; j++) *to++ = joint_sides[stages_->joints[stage.joints + j]];
        const double* tape = tape_.data() + step.tape;
        for (int j = 0; j < stage.count + step.handed; j++) {
            const int left = step.rows - j;
            double sum = 0.0;
            for (int i = 0; i < left; i++) sum += tape[1 + i] * y[j + i];
            sum *= tape[0];
            for (int i = 0; i < left; i++) y[j + i] -= sum * tape[1 + i];
            tape += left + 1;
        }
        copy_few(y, found_.data() + stage.joints, stage.count);
        copy_few(y + stage.count, values_.data() + size_t(TWIST) * n, step.handed);
    }

    void substitute(int n, double* u) {
        const Stage& stage = stages_->all[n];
        const int count = stage.count, w = width(count);
        const double *root = roots_.data() + steps_[n].root, *q = found_.data() + stage.joints;
        double *s = twists_.data() + size_t(TWIST) * n, own[Stages::MOST];
        const double* t = stage.before == BASE ? nullptr : twists_.data() + size_t(TWIST) * stage.before;
        for (int j = count - 1; j >= 0; j--) {
            const double* row = root + size_t(j) * w;
            double value = q[j] - (t ? product(row + count, t) : 0.0);
            for (int i = j + 1; i < count; i++) value -= row[i] * own[i];
            own[j] = row[j] == 0.0 ? 0.0 : value / row[j];
        }
        if (t) move_twist(t, stage.arm, s);
        else clear(s, TWIST);
        for (int j = 0; j < count; j++) {
            u[stages_->joints[stage.joints + j]] = own[j];
            for (int k = 0; k < TWIST; k++) s[k] += stages_->axis(stage, j)[k] * own[j];
        }
    }

    const Stages* stages_ = nullptr;
    std::vector<Step> steps_;
    std::vector<int> sorted_;
    std::vector<double> tape_, roots_, handed_, rows_, values_, found_, twists_;
};

}  // namespace prioritized_ik
