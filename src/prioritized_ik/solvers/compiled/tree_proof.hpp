// Proof that a step on a kinematic tree is the lexicographic optimum, in doubles: solvers/tree/certificate.py, which says what
// and why; names are the same.
#pragma once

#include "tree_problem.hpp"

namespace prioritized_ik {

class TreeProof : public PosedOnTree {
  protected:
    using PosedOnTree::PosedOnTree;

    // One level's optimality.
    struct LevelProof {
        double gap, demand, excess, rounding, carried;
        bool pulls, is_unclear;
        double relative_gap() const { return gap != 0.0 && demand != 0.0 ? gap / (demand * demand) : 0.0; }
    };

    // Proves the step u_, of which `look` was taken, on the face of side_ and held_, which is factored.
    void prove() {
        const int m = m_, last = levels() + 1;
        off_.assign(m, 0.0);
        above_ = 0.0;
        is_on_any_ = false;
        for (int j = 0; j < m; j++) is_on_any_ = is_on_any_ || side_[j] != 0;
        for (int i = 0; i < c_; i++) is_on_any_ = is_on_any_ || held_[i] != 0;
        for (auto* array : {&rest_, &of_bounds_, &given_, &sizes_of_last_}) array->resize(m);
        for (auto* array : {&pulls_on_, &sizes_, &no_sizes_}) array->resize(k_);
        for (int i = 0; i < k_; i++)
            sizes_[i] = roots_[i] * (abs(sides_[i]) + terms_[i]) + roots_[i] * abs(missing_by_[i]);
        if (is_on_any_) {
            leak_of_bounds_.assign(m, INFINITE), leak_of_rows_.assign(c_, INFINITE);
            faint_bounds_.assign(m, 0), faint_rows_.assign(c_, 0);
            wrong_bounds_.assign(m, 0), wrong_rows_.assign(c_, 0);
            bounds_.assign(size_t(m) * last, 0.0), rows_.assign(size_t(c_) * last, 0.0);
        }
        proofs_.clear();
        for (int number = 1; number <= last; number++) {
            proofs_.push_back(prove(number, number == last));
            if (proofs_.back().pulls) break;
        }
    }

    int levels() const { return int(ends_.size()) - 2; }

    double excess() const {
        double most = 0.0;
        for (const LevelProof& level : proofs_) most = max(most, level.excess);
        return most;
    }

    double violation() const {
        double over = 0.0;
        for (int j = 0; j < m_; j++) over = max(over, max(u_[j] - upper_[j], lower_[j] - u_[j]));
        for (int i = 0; i < c_; i++) over = max(over, -slack_[i]);
        return over;
    }

    bool is_pulled() const { return proofs_.back().pulls; }

    // Whether a bound or row carries a multiplier at some level.
    bool is_held() const {
        const auto positive = [](double one) { return one > 0.0; };
        return is_on_any_ && (std::any_of(bounds_.begin(), bounds_.end(), positive) || std::any_of(rows_.begin(), rows_.end(), positive));
    }

    bool holds_with_margin() const {
        if (int(proofs_.size()) < levels() + 1 || is_pulled()) return false;
        double excess = violation(), gap = 0.0, rounding = 0.0;
        for (size_t i = 0; i < proofs_.size(); i++) {
            const LevelProof& level = proofs_[i];
            if (level.is_unclear) return false;
            excess = max(excess, level.excess);
            rounding = max(rounding, level.rounding);
            if (i + 1 < proofs_.size()) gap = max(gap, level.relative_gap());
        }
        const double variation = max(rounding / scale_, sqrt(proofs_.back().relative_gap()));
        return excess <= tol_.MARGIN * tol_.CERTIFIED * scale_ && gap <= tol_.MARGIN * tol_.GAP &&
               variation <= tol_.MARGIN * tol_.UNDECIDED;
    }

    double scale_ = 1.0;
    std::vector<double> u_;      // the step, in the metric
    std::vector<int8_t> side_;   // of each joint: at its upper bound 1, at its lower one -1, 0 if free
    std::vector<uint8_t> held_;  // which inequality rows are tight
    std::vector<LevelProof> proofs_;
    std::vector<double> bounds_, rows_;              // multipliers, level by level (levels + 1, m), (levels + 1, c)
    std::vector<uint8_t> wrong_bounds_, wrong_rows_;  // which pull at the last level

  private:
    static constexpr double PULLS = 4.0, FAR = 1e300;  // of certificate.py

    LevelProof prove(int number, bool is_last) {
        const int m = m_;
        double demand, strength = 1.0, cost, steepest = 1.0;
        const double *given, *sizes;
        if (is_last) {
            for (int j = 0; j < m; j++) {
                given_[j] = u_[j] - reference_[j];
                sizes_of_last_[j] = abs(u_[j]) + abs(reference_[j]);
            }
            given = given_.data(), sizes = sizes_of_last_.data();
            demand = norm(u_.data(), m) + norm(reference_, m), cost = norm(given, m);
        } else {
            const int first = ends_[number], count = ends_[number + 1] - first;
            std::fill(no_sizes_.begin(), no_sizes_.end(), 0.0);
            copy(sizes_.data() + first, no_sizes_.data() + first, count);
            given = missing_by_.data(), sizes = no_sizes_.data();
            strength = strengths_[number], cost = norm(given + first, count);
            steepest = strongest_[number] != 0.0 ? strongest_[number] : strength;
            demand = max(demands_[number], max(cost, tol_.LEAST_DEMAND * strength * scale_));
        }
        const Balance found = balance(number, given, sizes, 2.0 * tol_.EPS, is_on_any_, off_.data(), rest_.data(), pulls_on_.data(),
                                      of_bounds_.data());
        const double unfelt = max(0.0, found.astray - PULLS * found.noise);
        double excess = found.moved;
        if (unfelt != 0.0) {
            const double least = tol_.UNFELT * steepest;
            excess += unfelt / (least * least);
        }
        double gap = found.lower + 2.0 * unfelt * scale_, loosened = 0.0, pulled = 0.0;
        bool pulls = false, is_unclear = false;
        if (is_on_any_) {
            double *bounds = bounds_.data() + size_t(m) * (number - 1), *rows = rows_.data() + size_t(c_) * (number - 1);
            for (int j = 0; j < m; j++) bounds[j] = side_[j] == 0 || is_frozen(j) ? 0.0 : -rest_[j] * side_[j];
            for (int i = 0; i < c_; i++) rows[i] = held_[i] ? pulls_on_[i] : 0.0;
            gap += slackness(bounds, rows);
            const double faint = tol_.NEARLY * faintness(number, is_last, cost);
            for (int j = 0; j < m; j++) {
                pulled += abs(bounds[j]);
                if (side_[j] != 0)
                    tell(bounds[j], of_bounds_[j], faint, leak_of_bounds_[j], faint_bounds_[j], wrong_bounds_[j], gap, pulls, is_unclear);
            }
            for (int i = 0; i < c_; i++) {
                pulled += abs(rows[i]) * lengths_[i];
                if (held_[i] && tell(rows[i], found.of_rows, faint / lengths_[i], leak_of_rows_[i], faint_rows_[i], wrong_rows_[i], gap,
                                     pulls, is_unclear))
                    loosened += abs(slack_[i]);
            }
        }
        const double above = above_, rounding = max(found.feigned, loosened);
        const double carried = 2.0 * (strength * cost + pulled) * above + strength * above * (strength * above);
        above_ = max(above_, rounding);
        return LevelProof{gap, demand, excess, rounding, carried, pulls, is_unclear};
    }

    // See `_told`: of one active row; whether it holds the level as the first above, and its leak is noted.
    bool tell(double multiplier, double uncertain, double faint, double& leak, uint8_t& is_faint, uint8_t& is_wrong, double gap,
              bool& pulls, bool& is_unclear) const {
        if (leak < INFINITE) return false;
        if (multiplier < -PULLS * uncertain) {
            is_wrong = multiplier < -faint && !is_faint;
            (is_wrong ? pulls : is_unclear) = true;
        }
        const bool first = multiplier > uncertain && multiplier > faint;
        if (first) leak = gap / multiplier;
        else if (multiplier > PULLS * uncertain) is_faint = 1;
        return first;
    }

    double slackness(const double* bounds, const double* rows) const {
        double sum = 0.0;
        for (int i = 0; i < c_; i++) {
            if (rows[i] == 0.0) continue;
            const double room = abs(slack_[i]), leak = min(leak_of_rows_[i], FAR);
            sum += abs(rows[i]) * (rows[i] < 0.0 && leak < FAR ? leak : room <= tol_.ROUNDING * scale_ ? 0.0 : room * lengths_[i]);
        }
        for (int j = 0; j < m_; j++)
            if (bounds[j] < 0.0 && leak_of_bounds_[j] < INFINITE) sum += -bounds[j] * min(leak_of_bounds_[j], FAR);
        return 2.0 * sum;
    }

    double faintness(int number, bool is_last, double cost) const {
        double squares = 0.0;
        for (int i = 0; i < k_; i++) {
            const bool is_own = !is_last && i >= ends_[number] && i < ends_[number + 1];
            const double value = (abs(pulls_on_[i]) + (is_own ? abs(missing_by_[i]) : 0.0)) * roots_[i] * lengths_[i];
            squares += value * value;
        }
        return tol_.NOISE * (sqrt(squares) + (is_last ? cost : 0.0));
    }

    double above_ = 0.0;      // how far rounding can have moved the step at the levels so far
    bool is_on_any_ = false;  // whether the step rests on any bound or row
    std::vector<double> off_, rest_, of_bounds_, given_, sizes_of_last_, pulls_on_, sizes_, no_sizes_;
    std::vector<double> leak_of_bounds_, leak_of_rows_;
    std::vector<uint8_t> faint_bounds_, faint_rows_;
};

}  // namespace prioritized_ik
