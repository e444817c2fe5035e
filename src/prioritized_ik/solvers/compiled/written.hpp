// The sixth layer: writes a step that is proven, if its certificate has margin; fast.py reads it.
#pragma once

#include "certificate.hpp"

namespace prioritized_ik {

class Written : public Certified {
  protected:
    using Certified::Certified;

    bool is_written_ = false;
    bool is_open_ = false;  // whether rounding leaves the written step undecided by more than a certificate allows

    // Takes the step by as much further as rounding put it off.
    void mend() {
        add(1.0, mend_, u_, stride);
        keep_frozen();
        measure();
    }

    bool is_looked_at(int i) const { return level_of_[i] < looked_at_; }
    bool is_exceeded(int i) const { return i >= hard_ && is_looked_at(i) && reach_[i] < -tol_.CERTIFIED * scale_; }
    bool is_near(int i) const { return is_looked_at(i) && reach_[i] <= tol_.CERTIFIED * scale_ && !is_exceeded(i); }

    // Whether the step rests on exactly the rows that it ends on.
    bool rests_on_near() const {
        bool same = true;
        for (int i = 0; i < all_; i++) same = same && active_[i] == is_near(i) && exceeded_[i] == is_exceeded(i);
        return same;
    }

    // Writes the proven step, if its certificate has margin, or has it where rows with multipliers are looked at closer.
    void conclude(const int* ids, int t) {
        is_open_ = false;
        const bool is_clear = !is_weak_ && is_optimal(tol_.MARGIN) && variation() <= tol_.MARGIN * tol_.UNDECIDED;
        if (!is_clear) {
            for (int again = 0; !prove(ids, t, true) || !is_optimal(tol_.CLOSE_MARGIN); again++) {
                if (!mends_ || again == int(tol_.REFINEMENTS)) throw Declined{UNPROVEN};
                mend();
                if (!rests_on_near()) throw Declined{NEARLY_TIGHT};
            }
            // A rank tolerance that cuts leaves this core with coarser figures than the Python form has.
            is_open_ = rank_tolerance_ == 0.0 && closest_ > tol_.PLAINLY * tol_.UNDECIDED;
            if (!is_open_ && variation() > tol_.CLOSE_MARGIN * tol_.UNDECIDED) throw Declined{UNPROVEN};
        }
        if (doubt_) throw Declined{NEARLY_DECIDED};
        const double near = tol_.CERTIFIED * scale_;
        double violation = max(0.0, -worst_hard_);
        for (int i = 0; i < equalities_; i++)
            violation = max(violation, abs(dot(equal_ + size_t(i) * stride, u_, stride) - equal_side_[i]));
        if (violation > tol_.MARGIN * near) throw Declined{UNPROVEN};
        // What mending it moves, if rows push: Proof._loose.
        if (t && -worst_hard_ > tol_.ROUNDING * scale_ / tol_.MARGIN) throw Declined{UNPROVEN};
        // Beyond, whoever proves a step with this margin finds it loose: a hard row that pushes, or a soft one.
        const auto is_between = [&](double off) { return off > tol_.MARGIN * near && off < (1.0 + tol_.MARGIN) * near; };
        for (int k = 0; k < t && ids[k] < hard_; k++)
            if (is_between(reach_[ids[k]]) && pushes(k, t)) throw Declined{NEARLY_TIGHT};
        for (int i = hard_; i < all_; i++)
            if (is_between(abs(reach_[i]))) throw Declined{NEARLY_TIGHT};
        is_written_ = true;
        const int levels = now_.levels;
        double* figures = io.figures + FIGURES * (levels + 1);
        figures[0] = violation / scale_;
        figures[1] = scale_;

        for (int j = 0; j < m_; j++) io.dtheta[j] = u_[j] / io.metric_root[j];
        int32_t *counts = io.lists, *list = counts + COUNTS;
        std::fill_n(io.kept, all_, LOOSE);
        for (int i = 0; i < t; i++) *list++ = ids[i], io.kept[ids[i]] = TIGHT_ROW;
        counts[ACTIVE] = t;
        for (int i = hard_; i < all_; i++)
            if (exceeded_[i]) *list++ = i, counts[EXCEEDED]++, io.kept[i] = NOT_KEPT;
        for (int i = 0; i < hard_; i++) {
            const int joint = i < m_ ? i : i - m_;
            const bool frozen = i < 2 * m_ && frozen_ && io.lower[joint] == io.upper[joint];
            if (frozen || reach_[i] <= tol_.ACCEPTED_VIOLATION * scale_) *list++ = i, counts[TIGHT]++;
        }
        std::sort(zero_, zero_ + counts[ZERO]);
        for (int i = 0; i < counts[ZERO]; i++) *list++ = zero_[i];
        for (int l = 0; l <= levels; l++)
            for (int i = 0; i < t; i++)
                if (const double value = multipliers_[size_t(l) * t + i]; value > 0.0) {
                    *list++ = l;
                    *list++ = ids[i];
                    io.multipliers[counts[HOLDING]++] = value;
                }
        io.used = int(list - counts);
        for (int l = 0; l < levels; l++) {
            const Block& block = levels_[l];
            double cost = 0.0;
            for (int i = block.first; i < block.first + block.given; i++) {
                double off = dot(io.matrix.data() + size_t(i) * stride, io.dtheta, stride) - io.target[i];
                if (block.is_soft) off = max(off, 0.0);
                cost += io.weights[i] * off * off;
            }
            figures[2 + l] = cost;
        }
    }

  private:
    // Whether the row that is k-th of the t that a proof rests on has a multiplier in any level.
    bool pushes(int k, int t) const {
        for (int l = 0; l <= now_.levels; l++)
            if (multipliers_[size_t(l) * t + k] != 0.0) return true;
        return false;
    }

    // Whether no level's cost could be lower, gaps with `margin`.
    bool is_optimal(double margin) const {
        const double* figures = io.figures;
        for (int l = 0; l <= now_.levels; l++, figures += FIGURES) {
            if (!(figures[STATIONARITY] <= tol_.MARGIN * tol_.CERTIFIED)) return false;
            if (l < now_.levels && !(figures[RELATIVE_GAP] <= margin * tol_.GAP)) return false;
        }
        return true;
    }

    // How far rounding may move the step, see Certificate.variation.
    double variation() const {
        const double* figures = io.figures;
        double largest = 0.0;
        for (int l = 0; l <= now_.levels; l++, figures += FIGURES) largest = max(largest, figures[ROUNDING]);
        return max(largest, sqrt(io.figures[size_t(now_.levels) * FIGURES + RELATIVE_GAP]));
    }
};

}  // namespace prioritized_ik
