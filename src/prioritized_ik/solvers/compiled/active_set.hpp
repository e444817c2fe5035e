// The sixth layer: from a guess of active rows to those of the optimum; see active_set.py.
#pragma once

#include "written.hpp"

namespace prioritized_ik {

class ActiveSet : public Written {
  protected:
    using Written::Written;

    int listed(int* ids) const {
        int t = 0;
        for (int i = 0; i < all_; i++)
            if (active_[i]) ids[t++] = i;
        return t;
    }

    uint64_t digest() const {
        uint64_t hash = 1469598103934665603ull;
        for (int i = 0; i < all_; i++) hash = (hash ^ (active_[i] + 2 * exceeded_[i])) * 1099511628211ull;
        return hash;
    }
    bool is_visited() const { return std::find(visited_.begin(), visited_.end(), digest()) != visited_.end(); }

    // From the active rows to the optimum; false if that leads nowhere in `most` sets. No set is visited twice: where the rule
    // would return to one, the next best row is dropped instead. Of some of the levels alone nothing is written.
    bool search(int most) {
        Scope scope(arena_);
        int* ids = arena_.array<int>(all_);
        uint8_t* proven = arena_.array<uint8_t>(2 * all_);  // active and exceeded rows at the last proof, and the slacks there
        double* proven_slack = arena_.doubles(all_);
        size_t next = 0;
        visited_.clear();
        wrong_.clear();
        slacks(start_, slack_);
        auto dropped = [&] {
            const bool other = std::memcmp(exceeded_, proven + all_, all_) != 0;
            std::memcpy(exceeded_, proven + all_, all_);
            for (; next < wrong_.size(); next++) {
                std::memcpy(active_, proven, all_);
                active_[wrong_[next]] = 0;
                if (!is_visited()) {
                    if (other) refactor();
                    copy(proven_slack, slack_, all_);
                    return true;
                }
            }
            return false;
        };
        for (int iteration = 0; iteration < most; iteration++) {
            visited_.push_back(digest());
            face(ids, listed(ids));
            measure();
            if (!(size_ < INFINITE)) return false;
            io.lists[CORRECTIONS] = iteration;
            if (advance()) {
                if (is_visited() && !dropped()) return false;
                continue;
            }
            if (soft_ && sort_soft()) {
                if (is_visited() && !dropped()) return false;
                continue;
            }
            bool loose = false;
            for (int i = 0; i < all_; i++)
                if (active_[i] && reach_[i] > tol_.CERTIFIED * scale_) active_[i] = 0, loose = true;
            if (loose) {
                if (is_visited() && !dropped()) return false;
                continue;
            }
            bool same = true;
            int t = 0;
            for (int i = 0; i < all_; i++)
                if (is_near(i)) ids[t++] = i, same = same && active_[i];
            if (prove(ids, t)) {
                if (looked_at_ < now_.levels) return true;
                if (!same) settle(ids);
                else conclude(ids, t);
                return true;
            }
            std::memcpy(proven, active_, all_);
            std::memcpy(proven + all_, exceeded_, all_);
            copy(slack_, proven_slack, all_);
            next = 0;
            if (!dropped()) return false;
        }
        return false;
    }

    // The ratio test: how far towards u_ each blocking row lets go. Returns whether one does not.
    bool advance() {
        double first = INFINITE;
        const double kept = tol_.KEPT * scale_;
        for (int i = 0; i < all_; i++)
            if (blocks(i, kept)) {
                const double rate = slack_[i] - reach_[i];
                first = min(first, rate > 0.0 ? max(slack_[i], 0.0) / rate : 0.0);
            }
        if (first == INFINITE) {
            copy(reach_, slack_, all_);
            return false;
        }
        for (int i = 0; i < all_; i++) {
            if (blocks(i, kept)) {
                const double rate = slack_[i] - reach_[i];
                if ((rate > 0.0 ? max(slack_[i], 0.0) / rate : 0.0) <= first) active_[i] = 1;
            }
            if (side_[i] < INFINITE) slack_[i] += first * (reach_[i] - slack_[i]);
        }
        return true;
    }

    bool blocks(int i, double kept) const { return is_looked_at(i) && !active_[i] && !exceeded_[i] && reach_[i] < -kept; }
    bool is_looked_at(int i) const { return level_of_[i] < looked_at_; }

    bool is_exceeded(int i) const { return i >= hard_ && is_looked_at(i) && reach_[i] < -tol_.CERTIFIED * scale_; }
    bool is_near(int i) const { return is_looked_at(i) && reach_[i] <= tol_.CERTIFIED * scale_ && !is_exceeded(i); }

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

    // The step of exactly the rows that it ends on, so that all guesses that lead there lead to the same bits; proven anew.
    void settle(int* ids) {
        constexpr int TRIES = 3;
        for (int again = 0; again < TRIES; again++) {
            for (int i = 0; i < all_; i++) active_[i] = is_near(i);
            if (soft_) sort_all_soft();
            const int t = listed(ids);
            face(ids, t);
            measure();
            bool same = true;
            for (int i = 0; i < all_; i++) same = same && active_[i] == is_near(i) && exceeded_[i] == is_exceeded(i);
            if (!same) continue;
            if (!prove(ids, t)) throw Declined{UNPROVEN};
            conclude(ids, t);
            return;
        }
        throw Declined{UNSETTLED};
    }

  private:
    std::vector<uint64_t> visited_;
};

}  // namespace prioritized_ik
