// A problem on a kinematic tree in its joint metric, as the rows that an elimination takes: solvers/tree/posed.py, which says
// what and why; names are the same.
#pragma once

#include "tree.hpp"

namespace prioritized_ik {

// Some rows of motions of points; weights are null where all are one.
struct TreeRows {
    int64_t count;
    const int64_t* joints;                                   // (count)
    const double *points, *directions, *targets, *weights;  // (count, 3), (count, 3), (count), (count)
};

// What the caller owns and fills: `given` in compiled/tree_step.py, number by number. The metric is null where it is one.
struct TreeProblem {
    double rank_tolerance;
    int64_t joints, levels, question;
    const int64_t* parents;                          // (m)
    const double *angular, *linear, *anchors;        // (m, 3)
    const double *metric, *lower, *upper, *reference;  // (m)
    const uint8_t* guess;                            // upper bounds, lower bounds, inequality rows; null of none
    double *dtheta, *figures;                        // out, see exchange.hpp
    int32_t* lists;
    uint8_t* kept;
    TreeRows parts[1];                               // levels + 1, the inequality rows first
};

// With the elimination of its faces.
class PosedOnTree : public TreeElimination {
  public:
    explicit PosedOnTree(const Tolerances& tolerances) : tol_(tolerances) {}

  protected:
    static constexpr double CLEAR_ROW = 1e-7;  // of posed.py

    void read(const TreeProblem& problem) {
        const int m = m_ = int(problem.joints), levels = int(problem.levels);
        c_ = int(problem.parts[0].count);
        ends_.assign(1, 0);
        for (int part = 0; part <= levels; part++) ends_.push_back(ends_.back() + int(problem.parts[part].count));
        k_ = ends_.back();
        parents_.assign(problem.parents, problem.parents + m);
        for (auto* array : {&row_joints_, &row_levels_}) array->resize(k_);
        for (auto* array : {&points_, &directions_}) array->resize(size_t(3) * k_);
        for (auto* array : {&targets_, &sides_, &roots_, &lengths_}) array->resize(k_);
        for (int part = 0; part <= levels; part++) {
            const TreeRows& rows = problem.parts[part];
            const int first = ends_[part], count = int(rows.count);
            std::copy_n(rows.joints, count, row_joints_.data() + first);
            std::fill_n(row_levels_.data() + first, count, part);
            copy(rows.points, points_.data() + size_t(3) * first, size_t(3) * count);
            copy(rows.directions, directions_.data() + size_t(3) * first, size_t(3) * count);
            copy(rows.targets, targets_.data() + first, count);
            for (int i = 0; i < count; i++) {
                const double side = rows.targets[i], root = rows.weights ? sqrt(rows.weights[i]) : 1.0;
                roots_[first + i] = rows.joints[i] < 0 ? 0.0 : root;
                sides_[first + i] = std::isfinite(side) ? side * roots_[first + i] : 0.0;
            }
        }
        TreeInput in{};
        in.joints = m, in.rows = k_, in.levels = levels;
        in.zero = tol_.TREE_ZERO, in.rounding = tol_.ROUNDING, in.noise = tol_.NOISE;
        in.angular = problem.angular, in.linear = problem.linear;
        lower_ = problem.lower, upper_ = problem.upper, reference_ = problem.reference;
        metric_root_.clear();
        if (problem.metric && std::any_of(problem.metric, problem.metric + m, [](double one) { return one != 1.0; })) in_metric(problem, in);
        fixed_.assign(m, 0), counts_.assign(k_, 0), ranks_.resize(levels + 1), strongest_.resize(levels + 1), weakest_.resize(levels + 1);
        in.parents = parents_.data(), in.row_joints = row_joints_.data(), in.row_levels = row_levels_.data();
        in.anchors = problem.anchors, in.points = points_.data(), in.directions = directions_.data(), in.roots = roots_.data();
        in.fixed = fixed_.data(), in.counts = counts_.data(), in.lengths = lengths_.data();
        in.strongest = strongest_.data(), in.weakest = weakest_.data(), in.ranks = ranks_.data();
        pose(in);
        strengths_.assign(levels + 1, 0.0), demands_.assign(levels + 1, 0.0);
        for (int level = 1; level <= levels; level++) {
            double strength = 0.0;
            for (int i = ends_[level]; i < ends_[level + 1]; i++) strength += roots_[i] * lengths_[i] * (roots_[i] * lengths_[i]);
            strengths_[level] = sqrt(strength);
            demands_[level] = norm(sides_.data() + ends_[level], ends_[level + 1] - ends_[level]);
        }
        for (auto* array : {&motions_, &terms_, &missing_by_}) array->resize(k_);
        slack_.resize(c_);
    }

    bool is_frozen(int j) const { return lower_[j] == upper_[j]; }

    bool has_clear_rows() const {
        double least = INFINITE, most = 0.0;
        for (int i = 0; i < c_; i++) least = min(least, lengths_[i]), most = max(most, lengths_[i]);
        return least > CLEAR_ROW * most;
    }

    // Notes how far u moves rows, what these lack, and how far they are from where they may go.
    void look(const double* u) {
        motions(u, motions_.data(), terms_.data());
        for (int i = 0; i < k_; i++) missing_by_[i] = sides_[i] - roots_[i] * motions_[i];
        for (int i = 0; i < c_; i++) slack_[i] = (targets_[i] - motions_[i]) / lengths_[i];
    }

    const Tolerances tol_;
    int m_ = 0, c_ = 0, k_ = 0;
    std::vector<int> ends_;  // where rows of inequalities, and of each level, begin, and the end of all
    const double *lower_ = nullptr, *upper_ = nullptr, *reference_ = nullptr;
    std::vector<double> metric_root_;  // none where it is one
    std::vector<double> targets_, sides_, roots_, lengths_, strengths_, demands_;
    std::vector<double> motions_, terms_, missing_by_, slack_;
    std::vector<uint8_t> fixed_, counts_;
    std::vector<double> strongest_, weakest_;
    std::vector<int32_t> ranks_;

  private:
    void in_metric(const TreeProblem& problem, TreeInput& in) {
        const int m = m_;
        metric_root_.resize(m);
        for (auto* array : {&lower_in_, &upper_in_, &reference_in_}) array->resize(m);
        for (auto* array : {&angular_in_, &linear_in_}) array->resize(size_t(3) * m);
        for (int j = 0; j < m; j++) {
            const double root = metric_root_[j] = sqrt(problem.metric[j]), factor = 1.0 / root;
            lower_in_[j] = problem.lower[j] * root, upper_in_[j] = problem.upper[j] * root;
            reference_in_[j] = problem.reference[j] * root;
            for (int i = 3 * j; i < 3 * j + 3; i++)
                angular_in_[i] = problem.angular[i] * factor, linear_in_[i] = problem.linear[i] * factor;
        }
        in.angular = angular_in_.data(), in.linear = linear_in_.data();
        lower_ = lower_in_.data(), upper_ = upper_in_.data(), reference_ = reference_in_.data();
    }

    std::vector<int32_t> parents_, row_joints_, row_levels_;
    std::vector<double> points_, directions_, lower_in_, upper_in_, reference_in_, angular_in_, linear_in_;
};

}  // namespace prioritized_ik
