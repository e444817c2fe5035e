// From a guess of the active bounds and rows, or none, to the lexicographic optimum on a kinematic tree in a few corrections:
// `Search.closed_form` and `_in_blocks` of solvers/tree/active_set.py, which says what and why; names are the same.
//
// What is not clear in doubles is declined, `UNPROVEN` as a rule, `RANK` where a rank tolerance cuts more than zeros, and what
// takes more corrections than that is `UNSETTLED`: the Python form answers then.
#pragma once

#include "tree_proof.hpp"

namespace prioritized_ik {

class TreeSearch : public TreeProof {
  public:
    using TreeProof::TreeProof;

    // An `Ending`, and above its eight bits how much of the lists is written.
    int step(const TreeProblem& problem) {
        try {
            const int ending = answer(problem);
            return ending | write(problem) << 8;
        } catch (const Declined& declined) {
            return declined.why;
        }
    }

  private:
    static constexpr double SHARE = 0.3, REFINED = 1e-11, LONG = 1e-3;  // of active_set.py
    static constexpr int FEW = 10;

    int answer(const TreeProblem& problem) {
        read(problem);
        if (!has_clear_rows()) throw Declined{ROUNDING_ROW};
        corrections_ = 0, least_ = -1.0, is_factored_ = false;
        if (problem.rank_tolerance > 0.0 && !has_clear_ranks(problem.rank_tolerance)) throw Declined{RANK};
        const Question question = Question(problem.question);
        bool is_told = false;  // what the guess leads to
        if (question != CLOSED_FORM_ONLY && guess(problem)) {
            if (!in_blocks()) throw Declined{UNSETTLED};
            is_told = true;
            if (question == FROM_GUESS_ONLY || is_held()) return is_held() ? SOLVED : CLOSED_FORM;
        }
        nothing();
        if (question != FROM_GUESS_ONLY) {
            corrections_ = 0;
            face();
            if (worst() >= -tol_.FREE * scale_) {
                prove_and_refine();
                if (!holds_with_margin()) throw Declined{UNPROVEN};
                return CLOSED_FORM;
            }
            if (question == CLOSED_FORM_ONLY) throw Declined{BINDING};
        }
        if (!in_blocks()) throw Declined{is_told ? UNPROVEN : UNSETTLED};
        return is_held() ? SOLVED : CLOSED_FORM;
    }

    // See `Search.has_clear_ranks`.
    bool has_clear_ranks(double tolerance) {
        nothing();
        if (!factor_face()) return false;
        int zeros = inputs();
        for (int level = 1; level <= levels(); level++) {
            for (int i = ends_[level]; i < ends_[level + 1]; i++)
                if (roots_[i] == 0.0 && lengths_[i] > 0.0) return false;  // which no factor knows
            zeros -= ranks_[level];
            const double most = norm(lengths_.data() + ends_[level], ends_[level + 1] - ends_[level]);
            if (count_below(level, tolerance * most) == zeros) continue;
            const double largest = norm_of_matrix(level);
            if (count_below(level, tolerance * largest * (1.0 - tol_.CUT_MARGIN)) != zeros) return false;
            if (count_below(level, tolerance * min(most, 1.01 * largest)) != zeros) return false;
        }
        return true;
    }

    void nothing() {
        side_.resize(m_);
        for (int j = 0; j < m_; j++) side_[j] = is_frozen(j);
        held_.assign(c_, 0);
    }

    // Fills in which bounds and rows the step may rest on; whether there are any.
    bool guess(const TreeProblem& problem) {
        nothing();
        if (!problem.guess) return false;
        bool any = false;
        const uint8_t *upper = problem.guess, *lower = upper + m_, *rows = lower + m_;
        for (int j = 0; j < m_; j++) {
            if (side_[j]) continue;
            if (upper[j] && upper_[j] < INFINITE) side_[j] = 1;
            else if (lower[j] && lower_[j] > -INFINITE) side_[j] = -1;
            any = any || side_[j];
        }
        for (int i = 0; i < c_; i++) {
            held_[i] = rows[i] && targets_[i] < INFINITE;
            any = any || held_[i];
        }
        return any;
    }

    // u_ := the step where the active bounds and rows hold as equalities.
    void face() {
        if (!factor_face()) throw Declined{UNPROVEN};
        u_.resize(m_), values_.resize(m_), kept_sides_ = sides_;
        for (int j = 0; j < m_; j++) values_[j] = side_[j] > 0 ? upper_[j] : side_[j] < 0 ? lower_[j] : 0.0;
        for (int i = 0; i < c_; i++)
            if (!held_[i]) kept_sides_[i] = 0.0;
        solve(values_.data(), kept_sides_.data(), reference_, u_.data());
        const double size = norm(u_.data(), m_);
        if (!std::isfinite(size)) throw Declined{UNPROVEN};
        look(u_.data());
        const double most = tol_.CERTIFIED * max(size, 1e-300);
        for (int i = 0; i < c_; i++)
            if (held_[i] && !(abs(slack_[i]) <= most)) throw Declined{UNPROVEN};
        scale_ = scale(size);
    }

    // Whether ranks of the face are clear.
    bool factor_face() {
        if (is_factored_ && side_ == factored_side_ && held_ == factored_held_) return true;
        for (int j = 0; j < m_; j++) fixed_[j] = side_[j] != 0;
        std::copy(held_.begin(), held_.end(), counts_.begin());
        std::fill(counts_.begin() + c_, counts_.end(), 1);
        is_factored_ = factor() == CLEAR;
        factored_side_ = side_, factored_held_ = held_;
        return is_factored_;
    }

    // See `Search._scale`.
    double scale(double size) {
        if (least_ < 0.0) {
            double wanted = 0.0, strength = 0.0;
            for (int i = 1; i <= levels(); i++) wanted = max(wanted, demands_[i]), strength = max(strength, strengths_[i]);
            if (size * strength > LONG * wanted) return size;
            least_ = 0.0;
            for (int i = 1; i <= levels(); i++)
                if (strengths_[i] > 0.0) least_ = max(least_, demands_[i] / strengths_[i]);
        }
        const double found = max(size, tol_.FLOOR * least_);
        return found > 0.0 ? found : 1.0;
    }

    double worst() const {
        double room = INFINITE;
        for (int j = 0; j < m_; j++) room = min(room, min(upper_[j] - u_[j], u_[j] - lower_[j]));
        for (int i = 0; i < c_; i++) room = min(room, slack_[i]);
        return room;
    }

    // See `Search._proven`.
    void prove_and_refine() {
        prove();
        double before = INFINITE;
        for (int turn = 0; turn < int(tol_.REFINEMENTS); turn++) {
            const double now = excess();
            if (now <= REFINED * scale_ || now > 0.5 * before) break;
            before = now;
            kept_sides_ = missing_by_;
            for (int i = 0; i < c_; i++)
                if (!held_[i]) kept_sides_[i] = 0.0;
            values_.assign(m_, 0.0), lacking_.resize(m_), more_.resize(m_);
            for (int j = 0; j < m_; j++) lacking_[j] = reference_[j] - u_[j];
            solve(values_.data(), kept_sides_.data(), lacking_.data(), more_.data());
            if (norm(more_.data(), m_) <= REFINED * scale_) break;
            for (int j = 0; j < m_; j++)
                if (side_[j] == 0) u_[j] += more_[j];
            look(u_.data());
            prove();
        }
    }

    // Corrects the set until its step is the optimum; whether a few corrections do.
    bool in_blocks() {
        double share = SHARE;
        visited_.clear();
        for (int turn = 0; turn < FEW; turn++) {
            visited_.push_back({side_, held_});
            face();
            const bool is_broken = find_broken(tol_.KEPT * scale_);
            prove_and_refine();
            if (!is_broken && !is_pulled()) {
                if (!holds_with_margin()) throw Declined{UNPROVEN};
                return true;
            }
            if (is_pulled()) {
                for (int j = 0; j < m_; j++)
                    if (wrong_bounds_[j]) side_[j] = 0;
                for (int i = 0; i < c_; i++)
                    if (wrong_rows_[i]) held_[i] = 0;
            } else add_worst(share);
            if (is_visited()) {
                share = 1.0;
                if (is_broken) side_ = visited_.back().first, held_ = visited_.back().second, add_worst(share);
                if (is_visited()) break;
            }
            corrections_++;
        }
        return false;
    }

    bool is_visited() const {
        return std::any_of(visited_.begin(), visited_.end(), [&](const auto& one) { return one.first == side_ && one.second == held_; });
    }

    // Notes bounds and rows, not active yet, that the step breaks by more than `kept`; whether there are any.
    bool find_broken(double kept) {
        broken_side_.assign(m_, 0), broken_rows_.assign(c_, 0);
        bool any = false;
        for (int j = 0; j < m_; j++) {
            if (side_[j]) continue;
            broken_side_[j] = u_[j] > upper_[j] + kept ? 1 : u_[j] < lower_[j] - kept ? -1 : 0;
            any = any || broken_side_[j];
        }
        for (int i = 0; i < c_; i++) {
            broken_rows_[i] = !held_[i] && slack_[i] < -kept;
            any = any || broken_rows_[i];
        }
        return any;
    }

    // See `Search._with_worst`.
    void add_worst(double share) {
        const auto over = [&](int j) { return broken_side_[j] > 0 ? u_[j] - upper_[j] : lower_[j] - u_[j]; };
        double most = 0.0;
        for (int j = 0; j < m_; j++)
            if (broken_side_[j]) most = max(most, over(j));
        for (int i = 0; i < c_; i++)
            if (broken_rows_[i]) most = max(most, -slack_[i]);
        for (int j = 0; j < m_; j++)
            if (broken_side_[j] && over(j) >= share * most) side_[j] = broken_side_[j];
        for (int i = 0; i < c_; i++)
            if (broken_rows_[i] && -slack_[i] >= share * most) held_[i] = 1;
    }

    // Writes the proven step as written.hpp does; returns how much of the lists is.
    int write(const TreeProblem& problem) {
        for (int j = 0; j < m_; j++) problem.dtheta[j] = metric_root_.empty() ? u_[j] : u_[j] / metric_root_[j];
        double* figures = problem.figures;
        for (const LevelProof& level : proofs_) {
            *figures++ = level.gap + level.carried;
            *figures++ = level.relative_gap();
            *figures++ = level.excess / scale_;
            *figures++ = level.rounding / scale_;
        }
        *figures++ = violation() / scale_;
        *figures++ = scale_;
        for (int level = 1; level <= levels(); level++) {
            const double* lacking = missing_by_.data() + ends_[level];
            *figures++ = dot(lacking, lacking, ends_[level + 1] - ends_[level]);
        }
        int32_t *counts = problem.lists, *list = counts + COUNTS;
        std::fill_n(counts, int(COUNTS), 0);
        counts[CORRECTIONS] = corrections_;
        std::memset(problem.kept, LOOSE, size_t(2) * m_ + c_);
        const auto keep = [&](int number) { *list++ = number, problem.kept[number] = TIGHT_ROW, counts[ACTIVE]++; };
        for (int side : {1, -1})
            for (int j = 0; j < m_; j++)
                if (side_[j] == side && !is_frozen(j)) keep(side > 0 ? j : m_ + j);
        for (int i = 0; i < c_; i++)
            if (held_[i]) keep(2 * m_ + i);
        const double near = tol_.ACCEPTED_VIOLATION * scale_;
        const auto tight = [&](int number, double room) {
            if (room <= near) *list++ = number, counts[TIGHT]++;
        };
        for (int j = 0; j < m_; j++) tight(j, upper_[j] - u_[j]);
        for (int j = 0; j < m_; j++) tight(m_ + j, u_[j] - lower_[j]);
        for (int i = 0; i < c_; i++) tight(2 * m_ + i, slack_[i]);
        if (!counts[ACTIVE]) return int(list - counts);
        for (int level = 0; level <= levels(); level++) {
            const auto holding = [&](int number, double multiplier) {
                if (multiplier > 0.0) *list++ = level, *list++ = number, counts[HOLDING]++;
            };
            for (int j = 0; j < m_; j++) holding(side_[j] > 0 ? j : m_ + j, bounds_[size_t(m_) * level + j]);
            for (int i = 0; i < c_; i++) holding(2 * m_ + i, rows_[size_t(c_) * level + i]);
        }
        return int(list - counts);
    }

    int corrections_ = 0;
    double least_ = -1.0;
    bool is_factored_ = false;
    std::vector<int8_t> factored_side_, broken_side_;
    std::vector<uint8_t> factored_held_, broken_rows_;
    std::vector<double> values_, kept_sides_, lacking_, more_;
    std::vector<std::pair<std::vector<int8_t>, std::vector<uint8_t>>> visited_;
};

}  // namespace prioritized_ik
