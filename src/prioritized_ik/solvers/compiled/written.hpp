// The fifth layer: writes a step that is proven, if its certificate has margin; fast.py reads it.
#pragma once

#include "certificate.hpp"

namespace prioritized_ik {

class Written : public Certified {
  protected:
    using Certified::Certified;

    bool is_written_ = false;

    // Writes the proven step, if its certificate has margin.
    void conclude(const int* ids, int t) {
        const int levels = now_.levels;
        const double margin = tol_.MARGIN, near = tol_.CERTIFIED * scale_;
        double violation = max(0.0, -worst_hard_), variation = 0.0;
        for (int i = 0; i < equalities_; i++)
            violation = max(violation, abs(dot(equal_ + size_t(i) * stride, u_, stride) - equal_side_[i]));
        double* figures = io.figures.data();
        bool clear_cut = violation <= margin * near;
        for (int l = 0; l <= levels; l++, figures += FIGURES) {
            clear_cut = clear_cut && figures[STATIONARITY] <= margin * tol_.CERTIFIED;
            if (l < levels) clear_cut = clear_cut && figures[RELATIVE_GAP] <= margin * tol_.GAP;
            else variation = max(variation, figures[RELATIVE_GAP]);
            variation = max(variation, figures[ROUNDING]);
        }
        if (!clear_cut || !(variation <= margin * tol_.UNDECIDED)) throw Declined{UNPROVEN};
        if (doubt_) throw Declined{NEARLY_DECIDED};
        if (-worst_hard_ > tol_.ROUNDING * scale_ / margin) throw Declined{UNPROVEN};  // what mending it moves: Proof._loose
        for (int i = 0; i < all_ && (t || soft_); i++) {
            const double off = i < hard_ ? reach_[i] : abs(reach_[i]);
            if (off > margin * near && off < near / margin) throw Declined{NEARLY_TIGHT};
        }
        is_written_ = true;
        figures[0] = violation / scale_;
        figures[1] = scale_;

        for (int j = 0; j < m_; j++) io.dtheta[j] = u_[j] / io.metric_root[j];
        int32_t *counts = io.lists.data(), *list = counts + COUNTS;
        std::fill(io.kept.begin(), io.kept.end(), LOOSE);
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
                double off = dot(io.matrix.data() + size_t(i) * stride, io.dtheta.data(), stride) - io.target[i];
                if (block.is_soft) off = max(off, 0.0);
                cost += io.weights[i] * off * off;
            }
            figures[2 + l] = cost;
        }
    }
};

}  // namespace prioritized_ik
