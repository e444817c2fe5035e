// One joint step and its certificate, in layers, each on those before it: posed.hpp, factored.hpp, face.hpp, extended.hpp,
// certificate.hpp, written.hpp, dual.hpp, active_set.hpp, and the course of a call here.
//
// What this cannot settle clearly (a rank near its cut, a row that the levels above nearly decide, a set of rows that does
// not come to rest, a certificate without margin) it declines: the Python form answers then.
#pragma once

#include "active_set.hpp"

namespace prioritized_ik {

class Step : public ActiveSet {
  public:
    using ActiveSet::ActiveSet;

    int solve(Question question) {
        for (;;) {
            try {
                is_written_ = is_open_ = false;
                const int outcome = answer(question);
                if (outcome != BINDING && !is_written_) return UNPROVEN;  // no step without its proof
                return is_open_ ? int(OPEN) : outcome;
            } catch (const Declined& declined) {
                return declined.why;
            } catch (const Arena::Exhausted&) {
                arena_.enlarge();
                factors_.enlarge();
            }
        }
    }

  private:
    int answer(Question question) {
        arena_.back_to(0);
        std::fill_n(io.lists, int(COUNTS), 0);
        read();
        factor();
        start_faces();
        active_ = arena_.array<uint8_t>(all_);
        std::memset(active_, 0, all_);
        start_searches();
        bool guessed = false;
        for (int i = 0; i < all_; i++) guessed = guessed || (io.guess[i] && side_[i] < INFINITE);

        // Rows of the last step come first, as a rule they are right. A step that they hold by a multiplier is not the closed
        // form's; any other may be, and where they are not right at once the closed form has the first word. Where soft rows
        // are exceeded it has it always: it has factors of its own.
        closed_form_ = -1.0;
        if (guessed && question == STEP) {
            start_from_guess();
            if (!exceeds()) {
                try {
                    if (search(1) && io.lists[HOLDING]) return SOLVED;
                } catch (const Declined&) {  // there is more to try
                }
                if (exceeds()) exceed_none();
                std::fill_n(io.lists, int(COUNTS), 0);
            }
            std::memset(exceeded_, 0, all_);
        }
        face(nullptr, 0);
        closed_form_ = norm(u_, m_);
        measure();
        if (question != FROM_GUESS_ONLY) {
            if (worst_ >= -tol_.FREE * scale_) {
                for (int again = 0; !prove(nullptr, 0); again++) {
                    if (!mends_ || again == int(tol_.REFINEMENTS)) throw Declined{UNPROVEN};
                    mend();
                    if (worst_ < -tol_.FREE * scale_) throw Declined{UNPROVEN};
                }
                conclude(nullptr, 0);
                return CLOSED_FORM;
            }
            if (question == CLOSED_FORM_ONLY) return BINDING;
        }
        // Rows of the last step say little of a problem of another kind, as once another link of a winding is in contact.
        for (const bool is_warm : {true, false}) {
            if (is_warm && (!guessed || io.settings[3])) continue;
            try {
                if (search_by_multipliers(is_warm)) return SOLVED;
            } catch (const Declined&) {  // there is more to try
            }
            exceed_none();
            face(nullptr, 0);
            measure();
        }
        std::memset(active_, 0, all_);
        start_search();
        if (search(most_sets())) return SOLVED;
        if (guessed) {
            start_from_guess();
            if (soft_) refactor();
            if (search(most_sets())) return SOLVED;
        }
        if (search_level_by_level()) return SOLVED;
        throw Declined{UNSETTLED};
    }

    // From the closed form, in u_ with its slacks, by the rows that a dual method guesses.
    bool search_by_multipliers(bool is_warm) {
        if (!guess_by_multipliers(is_warm)) return false;
        if (exceeds()) refactor();
        start_search();
        return search(most_sets());
    }

    // From nothing, one more level at a time, as stagewise.py.
    bool search_level_by_level() {
        std::memset(active_, 0, all_);
        std::memset(exceeded_, 0, all_);
        for (looked_at_ = 1; looked_at_ <= now_.levels; looked_at_++) {
            refactor();
            start_search();
            if (!search(most_sets())) return false;
        }
        return now_.levels > 0;
    }

    // How many sets a search visits before it is given up, see active_set.py.
    int most_sets() const { return int(tol_.ITERATIONS) * max(1, all_ / int(tol_.ROWS_PER_SEARCH)); }

    void start_from_guess() {
        for (int i = 0; i < all_; i++) {
            exceeded_[i] = i >= hard_ && io.guess[i] == NOT_KEPT && side_[i] < INFINITE;
            active_[i] = io.guess[i] && side_[i] < INFINITE && !exceeded_[i];
        }
        start_search();
    }

    bool exceeds() const { return std::any_of(exceeded_, exceeded_ + all_, [](uint8_t is) { return is != 0; }); }

    void exceed_none() {
        std::memset(exceeded_, 0, all_);
        if (soft_) refactor();
    }
};

}  // namespace prioritized_ik
