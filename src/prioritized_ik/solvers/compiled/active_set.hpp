// The eighth layer: from a guess of active rows to those of the optimum; see active_set.py.
#pragma once

#include "dual.hpp"

namespace prioritized_ik {

class ActiveSet : public DualGuess {
  protected:
    using DualGuess::DualGuess;

    int listed(int* ids) const {
        int t = 0;
        for (int i = 0; i < all_; i++)
            if (active_[i]) ids[t++] = i;
        return t;
    }

    uint64_t digest() const {
        constexpr int BYTES = 8;
        uint64_t hash = 1469598103934665603ull;
        for (int i = 0; i < all_; i += BYTES) {
            uint64_t active = 0, exceeded = 0;
            std::memcpy(&active, active_ + i, min(BYTES, all_ - i));
            std::memcpy(&exceeded, exceeded_ + i, min(BYTES, all_ - i));
            hash = (hash ^ (active + 2 * exceeded)) * 1099511628211ull;
            hash ^= hash >> 29;
        }
        return hash;
    }
    bool is_visited() const { return std::find(visited_.begin(), visited_.end(), digest()) != visited_.end(); }

    void start_searches() {
        ids_ = arena_.array<int>(all_);
        proven_ = arena_.array<uint8_t>(2 * all_);
        proven_slack_ = arena_.doubles(all_);
        mend_ = arena_.zeros(stride);
        unmended_ = arena_.zeros(stride);
    }

    // From the active rows on.
    void start_search() {
        visited_.clear();
        wrong_.clear();
        next_ = 0;
        is_stuck_ = false;
        fewest_ = all_;
        slacks(start_, slack_);
    }

    // Goes on to the optimum, for `most` further sets, with soft levels since fewer rows pulled than ever before; false if that
    // leads nowhere, or not yet. No set is visited twice: where the rule would return to one, the next best row is dropped
    // instead. Of some of the levels alone nothing is written.
    bool search(int most) {
        int* ids = ids_;
        for (size_t end = visited_.size() + most; visited_.size() < end && !is_stuck_;) {
            io.lists[CORRECTIONS] = int(visited_.size());
            visited_.push_back(digest());
            face(ids, listed(ids));
            measure();
            if (!(size_ < INFINITE)) break;
            if (advance() || (soft_ && sort_soft())) {
                is_stuck_ = is_visited() && !drop();
                continue;
            }
            if (has_loose()) {
                remember();
                for (int i : wrong_) active_[i] = 0;
                is_stuck_ = is_visited() && !drop();
                continue;
            }
            int t;
            if (prove_mended(ids, t)) {
                if (looked_at_ < now_.levels) return true;
                if (rests_on_near()) conclude(ids, t);
                else settle(ids);
                return true;
            }
            remember();
            if (soft_ && wrong_.size() < fewest_) {
                fewest_ = wrong_.size();
                end = visited_.size() + most;
            }
            is_stuck_ = !drop();
        }
        return false;
    }

    // The ratio test: how far towards u_ each blocking row lets go. Returns whether one does not.
    bool advance() {
        double first = INFINITE;
        const double kept = tol_.KEPT * scale_;
        blocking_.clear();
        for (int i = 0; i < all_; i++)
            if (reach_[i] < -kept && is_looked_at(i) && !active_[i] && !exceeded_[i]) {
                const double rate = slack_[i] - reach_[i], part = rate > 0.0 ? max(slack_[i], 0.0) / rate : 0.0;
                blocking_.push_back({part, i});
                first = min(first, part);
            }
        if (blocking_.empty()) {
            copy(reach_, slack_, all_);
            return false;
        }
        for (const auto& [part, i] : blocking_)
            if (part <= first) active_[i] = 1;
        for (int i = 0; i < all_; i++) slack_[i] = side_[i] < INFINITE ? slack_[i] + first * (reach_[i] - slack_[i]) : slack_[i];
        return true;
    }

    // Tells rows of soft levels that cannot be kept from those that are tight; returns whether some were not where they belong.
    bool sort_soft() {
        bool moved = false;
        for (int i = hard_; i < all_; i++) {
            if (exceeded_[i] ? is_exceeded(i) : !(active_[i] && is_exceeded(i))) continue;
            exceeded_[i] = is_exceeded(i);
            active_[i] = is_near(i);
            moved = true;
        }
        if (moved) refactor();
        return moved;
    }

    void sort_all_soft() {
        bool moved = false;
        for (int i = hard_; i < all_; i++) {
            moved = moved || exceeded_[i] != is_exceeded(i);
            exceeded_[i] = is_exceeded(i);
        }
        if (moved) refactor();
    }

    // Whether u_ is proven optimal from the rows `ids` (t) that it ends on, mended where rounding alone put it off.
    bool prove_mended(int* ids, int& t) {
        for (int again = 0;; again++) {
            t = 0;
            for (int i = 0; i < all_; i++)
                if (is_near(i)) ids[t++] = i;
            if (prove(ids, t)) return true;
            if (mends_ && again < int(tol_.REFINEMENTS)) {
                if (!again) copy(u_, unmended_, stride), unmended_wrong_ = wrong_;
                mend();
                if (keeps()) continue;
                again++;
            }
            if (again) {
                copy(unmended_, u_, stride);
                measure();
                wrong_ = unmended_wrong_;
            }
            return false;
        }
    }

    // Whether u_ breaks no row.
    bool keeps() const {
        for (int i = 0; i < all_; i++)
            if (is_looked_at(i) && !exceeded_[i] && reach_[i] < -tol_.KEPT * scale_) return false;
        return true;
    }

    // The step of exactly the rows that it ends on, so that all guesses that lead there lead to the same bits; proven anew.
    void settle(int* ids) {
        constexpr int TRIES = 3;
        for (int again = 0; again < TRIES; again++) {
            for (int i = 0; i < all_; i++) active_[i] = is_near(i);
            if (soft_) sort_all_soft();
            const int t = listed(ids);
            face(ids, t);
            measure();
            for (int i = 0; i < all_; i++)  // near each other, but without a step in common
                if (active_[i] && abs(reach_[i]) > tol_.KEPT * scale_) throw Declined{UNSETTLED};
            int near;
            const bool is_proven = prove_mended(ids, near);
            if (!rests_on_near()) continue;
            if (!is_proven) throw Declined{UNPROVEN};
            conclude(ids, t);
            return;
        }
        throw Declined{UNSETTLED};
    }

  private:
    // Whether there are active rows that the face cannot hold: they are `wrong_`, the loosest first.
    bool has_loose() {
        wrong_.clear();
        for (int i = 0; i < all_; i++)
            if (active_[i] && reach_[i] > tol_.CERTIFIED * scale_) wrong_.push_back(i);
        std::sort(wrong_.begin(), wrong_.end(), [&](int i, int j) { return reach_[i] > reach_[j]; });
        return !wrong_.empty();
    }

    // Keeps the set whose rows are `wrong_`.
    void remember() {
        std::memcpy(proven_, active_, all_);
        std::memcpy(proven_ + all_, exceeded_, all_);
        copy(slack_, proven_slack_, all_);
        next_ = 0;
    }

    // The set that was remembered last without the first two of its wrong rows, else without the next one; false if all such
    // sets were visited.
    bool drop() {
        const bool other = std::memcmp(exceeded_, proven_ + all_, all_) != 0;
        std::memcpy(exceeded_, proven_ + all_, all_);
        for (; next_ <= wrong_.size(); next_++) {
            if (!next_ && wrong_.size() < 2) continue;
            std::memcpy(active_, proven_, all_);
            if (next_) active_[wrong_[next_ - 1]] = 0;
            else active_[wrong_[0]] = active_[wrong_[1]] = 0;
            if (!is_visited()) {
                if (other) refactor();
                copy(proven_slack_, slack_, all_);
                return true;
            }
        }
        return false;
    }

    std::vector<uint64_t> visited_;
    std::vector<std::pair<double, int>> blocking_;  // rows on the way, and how far that is
    bool is_stuck_ = false;  // no set is left to go on with
    size_t fewest_ = 0;      // of the rows that pull, over the search
    double* unmended_ = nullptr;       // a step before it is mended,
    std::vector<int> unmended_wrong_;  // and the rows that pull there
    int* ids_ = nullptr;
    uint8_t* proven_ = nullptr;        // active and exceeded rows where some were wrong,
    double* proven_slack_ = nullptr;   // the slacks there,
    size_t next_ = 0;                  // and which set comes next, see `drop`
};

}  // namespace prioritized_ik
