// The third layer: the step where some rows hold as equalities, and how far that is from the others; see active_set.py.
#pragma once

#include <numeric>

#include "factored.hpp"

namespace prioritized_ik {

class Face : public Factored {
  protected:
    using Factored::Factored;

    void start_faces() {
        u_ = arena_.zeros(stride);
        x_ = arena_.zeros(stride);
        reach_ = arena_.doubles(all_);
        slack_ = arena_.doubles(all_);
        carried_ = arena_.doubles(size_t(all_) * stride);
        drift_ = arena_.doubles(size_t(all_) * stride);
        is_carried_ = arena_.array<uint8_t>(all_);
        settled_from_ = arena_.array<int>(all_);
        in_doubt_ = arena_.array<uint8_t>(all_);
        shares_ = arena_.array<int>(now_.levels + 2);
        std::memset(is_carried_, 0, all_);
        std::fill_n(settled_from_, all_, m_);
        std::memset(in_doubt_, 0, all_);
        broken_ = broken_at_start();
    }

    // Once other rows of soft levels are exceeded.
    void refactor() {
        factor();
        std::memset(is_carried_, 0, all_);
        std::fill_n(settled_from_, all_, m_);
        std::memset(in_doubt_, 0, all_);
    }

    const double* carried(int i) const { return carried_ + size_t(i) * stride; }

    // Carries hard rows into x, without what is too little of them to count, which is their drift.
    void carry(const int* ids, int t) {
        Scope scope(arena_);
        double** turned = arena_.array<double*>(t);
        int *fresh = arena_.array<int>(t), n = 0;
        for (int k = 0; k < t; k++) {
            const int i = ids[k];
            if (is_carried_[i]) continue;
            is_carried_[i] = 1;
            turned[n] = arena_.zeros(stride);
            if (i < 2 * m_) turned[n][i < m_ ? i : i - m_] = i < m_ ? 1.0 : -1.0;
            else copy(normal_ + size_t(i - 2 * m_) * stride, turned[n], stride);
            fresh[n++] = i;
        }
        chain_.apply(turned, n);
        for (int k = 0; k < n; k++) {
            double* row = carried_ + size_t(fresh[k]) * stride;
            for (int j = 0; j < m_; j++) row[j] = turned[k][place_[j]];
            clear(row + m_, stride - m_);
            split_drift(fresh[k], row);
        }
    }

    bool has_drift(int i) const { return settled_from_[i] < m_; }

    void split_drift(int i, double* row) {
        double* drift = drift_ + size_t(i) * stride;
        for (int l = 0; l < now_.levels; l++) {
            const int c = levels_[l].end();
            if (c == m_ || levels_[l].is_soft) continue;
            const double moves = norm(row + c, m_ - c);
            if (moves <= levels_[l].settled) {
                if (!has_drift(i)) clear(drift, stride);
                settled_from_[i] = min(settled_from_[i], c);
                for (int j = c; j < m_; j++) drift[j] += row[j], row[j] = 0.0;
            }
            if (may_be_settled(moves, levels_[l].settled)) in_doubt_[i] = 1;
        }
    }

    // ------------------------------------------------------------------------------------------------------ a face's step

    // x_ and u_ := the strict closed form where the rows `ids` (t) hold. See active_set.face_solution.
    void face(const int* ids, int t) {
        io.lists[FACES]++;
        doubt_ = is_weak_ = false;
        sharpness_ = 0.0;
        Scope scope(arena_);
        double *rows = arena_.doubles(size_t(t) * stride), *sides = arena_.doubles(t);
        bool drifting = false;
        carry(ids, t);
        for (int i = 0; i < t; i++) {
            copy(carried(ids[i]), rows + size_t(i) * stride, stride);
            sides[i] = side_[ids[i]];
            drifting = drifting || has_drift(ids[i]);
            doubt_ = doubt_ || in_doubt_[ids[i]];
        }
        hold(ids, rows, sides, t);
        if (drifting) {
            double worst = 0.0;
            for (int i = 0; i < t; i++) {
                copy(carried(ids[i]), rows + size_t(i) * stride, stride);
                const double moved = has_drift(ids[i]) ? dot(drift_ + size_t(ids[i]) * stride, x_, stride) : 0.0;
                sides[i] = side_[ids[i]] - moved;
                worst = max(worst, abs(moved));
            }
            if (worst > tol_.DRIFT * norm(x_, m_)) hold(ids, rows, sides, t);
        }
        out_of(x_, u_);
        keep_frozen();
    }

    void keep_frozen() {
        for (int j = 0, e = 0; e < frozen_; j++)
            if (io.lower[j] == io.upper[j]) u_[j] = equal_side_[e++];
    }

    // Rows of soft levels come after the hard ones, level by level, and are held from the level below theirs on.
    void hold(const int* ids, double* rows, double* sides, int all) {
        Scope scope(arena_);
        int t = 0;
        while (t < all && ids[t] < hard_) t++;
        int next = t;
        double* y = arena_.doubles(stride);
        copy(begin_, x_, stride);
        parted_.is_used = false;
        share(rows, sides, t, 0);
        for (int l = 0; l < now_.levels; l++) {
            const Block& block = levels_[l];
            const int c = block.start, r = block.rank, own = shares_[l + 1];
            copy(block.target(), y, r);
            for (int j = 0; j < c; j++)
                if (x_[j] != 0.0) add(-x_[j], block.above + size_t(j) * block.R.stride, y, r);
            meet(rows + size_t(own) * stride, sides + own, t - own, c, r, &block, y);
            t = own;
            block.R.solve(y);
            copy(y, x_ + c, r);
            const int left = next;
            for (; next < all && level_of_[ids[next]] == l; next++, t++) {
                copy(rows + size_t(next) * stride, rows + size_t(t) * stride, t < next ? stride : 0);
                sides[t] = sides[next];
            }
            if (next > left) share(rows, sides, t, l + 1);
        }
        const int c = rest_;
        if (has_reference_) {
            double* wanted = arena_.doubles(stride);
            into(reference_, wanted);
            copy(wanted + c, y, m_ - c);
        } else {
            clear(y, m_ - c);
        }
        if (parted_.is_used) meet_parted(rows, sides, y);
        else meet(rows, sides, t, c, m_ - c, nullptr, y);
        copy(y, x_ + c, m_ - c);
    }

    // Shares rows (t) out: each level from `first` on meets those combinations that the levels below it cannot move. Combines
    // the rows so that those of the lowest come first and are independent there, and the ones after them are zero there, and so on
    // upwards: level l meets the rows from shares_[l + 1] to shares_[l]. What x_ says already goes to the sides.
    void share(double* rows, double* sides, int t, int first) {
        const int levels = now_.levels, start = start_of(first);
        for (int l = first; l <= levels + 1; l++) shares_[l] = l > first ? 0 : t;
        for (int i = 0; i < t; i++) {
            double* row = rows + size_t(i) * stride;
            sides[i] -= dot(row, x_, start);
            clear(row, start);
        }
        parted_.is_used = t && levels > first && rest_ < m_;
        int top = parted_.is_used ? part(rows, sides, t, start) : 0;
        for (int l = first + 1; l <= levels; l++) shares_[l] = top;
        for (int l = levels - parted_.is_used, end = start_of(l + 1); l > first && top < t; end = start_of(l--)) {
            top += triangular(rows + size_t(top) * stride, sides + top, t - top, start, start_of(l), end);
            for (int higher = first + 1; higher <= l; higher++) shares_[higher] = top;
        }
        for (int l = first + 1, i = t; l <= levels; l++)
            for (; i > shares_[l]; i--) clear(rows + size_t(i - 1) * stride + start_of(l), m_ - start_of(l));
    }

    // Parts rows (t) into those that what no level decides can hold, which come first, and orthonormal combinations of all that
    // it does not move; returns how many the first are.
    int part(double* rows, double* sides, int t, int start) {
        const int c = rest_, r = m_ - c, s = padded(r);
        double* work = arena_.zeros(size_t(t) * s);
        double** row = parted_.row = arena_.array<double*>(t);
        parted_.chain.reset(arena_.doubles(size_t(r + 1) * s), r + 1, s);
        parted_.shares = arena_.doubles(size_t(t) * padded(t));
        parted_.combinations = arena_.doubles(size_t(t) * stride);
        parted_.sides = arena_.doubles(t);
        Scope scope(arena_);
        int* ids = arena_.array<int>(t);
        for (int i = 0; i < t; i++) {
            ids[i] = i;
            row[i] = work + size_t(i) * s;
            copy(rows + size_t(i) * stride + c, row[i], r);
        }
        double left;
        const int rank = row_pivoted_lq(row, ids, t, t, 0, r, s, parted_.chain, settled_, left, arena_);
        double *given = arena_.doubles(size_t(t) * stride), *given_sides = arena_.doubles(t);
        copy(rows, given, size_t(t) * stride);
        copy(sides, given_sides, t);
        for (int i = 0; i < t; i++) {
            copy(given + size_t(ids[i]) * stride, rows + size_t(i) * stride, stride);
            sides[i] = given_sides[ids[i]];
            if (may_be_settled(i < rank ? abs(row[i][i]) : norm(row[i] + rank, r - rank), settled_)) doubt_ = true;
        }
        parted_.count = t - rank;
        for (int i = rank; i < t; i++) combine(rows, sides, i, rank, t, start);
        copy(rows + size_t(rank) * stride, parted_.combinations, size_t(parted_.count) * stride);
        copy(sides + rank, parted_.sides, parted_.count);
        return rank;
    }

    // Row i becomes a combination with the `rank` first ones, and with those before it that are combinations already.
    void combine(double* rows, double* sides, int i, int rank, int t, int start) {
        const int c = rest_, from = aligned_start(start), apart = padded(t);
        double *own = parted_.shares + size_t(i - rank) * apart, *row = rows + size_t(i) * stride;
        clear(own, apart);
        own[i] = 1.0;
        for (int j = 0; j < rank; j++) own[j] = -parted_.row[i][j];
        for (int j = rank - 1; j >= 0; j--) {
            own[j] /= parted_.row[j][j];
            add(-own[j], parted_.row[j], own, j);
        }
        add_rows(own, rows + from, stride, rank, row + from, padded(c) - from);
        sides[i] += dot(own, sides, rank);
        for (int k = rank; k < i; k++) {
            const double* other = parted_.shares + size_t(k - rank) * apart;
            const double share = -dot(own, other, t);
            add(share, other, own, t);
            add(share, rows + size_t(k) * stride, row, c);
            sides[i] += share * sides[k];
        }
        const double scale = 1.0 / norm(own, t);
        for (int j = 0; j < t; j++) own[j] *= scale;
        for (int j = start; j < c; j++) row[j] *= scale;
        sides[i] *= scale;
        clear(row + c, stride - c);
    }

    // y, the wish of what no level decides, moves to the nearest that lets its rows hold; twice, as in `shift`. What the levels
    // leave of combinations that have no step in common is shared out among all rows.
    void meet_parted(const double* rows, const double* sides, double* y) {
        Scope scope(arena_);
        const int c = rest_, r = m_ - c, rank = shares_[now_.levels];
        double *z = arena_.doubles(padded(r)), *wanted = arena_.doubles(padded(rank + parted_.count));
        for (int i = 0; i < rank; i++) {
            const double* row = rows + size_t(i) * stride;
            wanted[i] = sides[i] - dot(row, x_, c);
            if (abs(parted_.row[i][i]) < tol_.WEAKEST * norm(row + c, r)) is_weak_ = true;
            sharpness_ += 1.0 / abs(parted_.row[i][i]);
        }
        for (int k = 0; k < parted_.count; k++) {
            const double unmet = parted_.sides[k] - dot(parted_.combinations + size_t(k) * stride, x_, c);
            add(-unmet, parted_.shares + size_t(k) * padded(rank + parted_.count), wanted, rank);
        }
        for (int again = 0; again < 2; again++) {
            clear(z, padded(r));
            for (int i = 0; i < rank; i++) {
                const double gap = wanted[i] - dot(rows + size_t(i) * stride + c, y, r);
                z[i] = (gap - dot(parted_.row[i], z, i)) / parted_.row[i][i];
            }
            parted_.chain.apply_reversed(z);
            for (int j = 0; j < r; j++) y[j] += z[j];
        }
    }

    // Turns rows (t) and their sides so that the first ones are independent in the coordinates from `begin` to `end`, and the
    // ones after them zero there, but for what is too little to count; returns how many the first ones are. Reflectors act on
    // rows as wholes, from `start` on.
    int triangular(double* rows, double* sides, int t, int start, int begin, int end) {
        Scope scope(arena_);
        const int from = aligned_start(start), n = padded(end) - from, most = min(t, end - begin);
        double *v = arena_.doubles(t), *sum = arena_.doubles(n);
        ShrinkingNorms norms(end, arena_);
        clear(sum, n);
        for (int i = 0; i < t; i++) add_squares(rows + size_t(i) * stride + from, sum, n);
        for (int j = begin; j < end; j++) norms.set(j, sum[j - from]);
        int rank = 0;
        for (; rank < most; rank++) {
            const int best = norms.longest(begin, end), left = t - rank;
            double *own = rows + size_t(rank) * stride, tau;
            for (int i = 0; i < left; i++) v[i] = own[size_t(i) * stride + best];
            const double size = reflector(v, v, left, tau);
            if (may_be_settled(abs(size), settled_)) doubt_ = true;
            if (!(abs(size) > settled_)) break;
            clear(sum, n);
            add_rows(v, own + from, stride, left, sum, n);
            const double turned = -tau * dot(v, sides + rank, left);
            for (int i = 0; i < left; i++) {
                double* row = own + size_t(i) * stride;
                add(-tau * v[i], sum, row + from, n);
                row[best] = i ? 0.0 : size;
                sides[rank + i] += turned * v[i];
            }
            norms.set(best, 0.0);
            for (int j = begin; j < end; j++)
                if (norms.shrinks_too_far(j, own[j])) norms.set(j, square_below(rows + j, rank + 1, t));
        }
        return rank;
    }

    // The sum of squares of rows from `first` to t in one coordinate.
    double square_below(const double* at, int first, int t) const {
        double sum = 0.0;
        for (int i = first; i < t; i++) sum += at[size_t(i) * stride] * at[size_t(i) * stride];
        return sum;
    }

    // Where a level's coordinates start, or those that no level decides.
    int start_of(int l) const { return l < now_.levels ? levels_[l].start : rest_; }

    // y (r), a level's wish in its own coordinates, moves to the nearest that lets rows (t) hold. `block` is null at the rest.
    void meet(const double* rows, const double* sides, int t, int c, int r, const Block* block, double* y) {
        if (!t || !r) return;
        Scope scope(arena_);
        double *normals = arena_.zeros(size_t(t) * stride), *gaps = arena_.doubles(t), *lengths = arena_.doubles(t);
        int *from = arena_.array<int>(t), moving = 0, n = 0;
        for (int i = 0; i < t; i++) {
            const double* row = rows + size_t(i) * stride;
            if (norm(row + c, m_ - c) <= tol_.DEPENDENT) continue;  // it copies other rows
            copy(row + c, normals + size_t(moving) * stride, r);
            from[moving++] = i;
        }
        if (block) block->R.solve_transposed(normals, stride, moving);
        for (int i = 0; i < moving; i++) {
            const double *row = rows + size_t(from[i]) * stride, *turned = normals + size_t(i) * stride, size = norm(turned, r);
            if (size == 0.0) continue;
            double* normal = normals + size_t(n) * stride;
            for (int j = 0; j < r; j++) normal[j] = turned[j] / size;
            lengths[n] = size;
            gaps[n++] = (sides[from[i]] - dot(row, x_, c)) / size;
        }
        if (n) shift(normals, gaps, lengths, n, r, block ? block->longest : 1.0, y);
    }

    // y := y + the shortest shift with normals (n), of these lengths before, y = gaps; twice, as the first leaves the rounding of
    // a large y. A step of y moves joints by `most` at most.
    void shift(const double* normals, const double* gaps, const double* lengths, int n, int r, double most, double* y) {
        Scope scope(arena_);
        const int s = padded(r);
        double* work = arena_.zeros(size_t(n) * s);
        double** row = arena_.array<double*>(n);
        int* ids = arena_.array<int>(n);
        for (int i = 0; i < n; i++) {
            row[i] = work + size_t(i) * s;
            ids[i] = i;
            copy(normals + size_t(i) * stride, row[i], r);
        }
        Reflectors& chain = small_chain_;
        chain.reset(arena_.doubles(size_t(min(n, r) + 1) * s), min(n, r) + 1, s);
        double left;
        const int rank = row_pivoted_lq(row, ids, n, n, 0, r, s, chain, tol_.DEPENDENT, left, arena_);
        for (int i = 0; i < rank; i++)
            if (abs(row[i][i]) < tol_.WEAKEST) is_weak_ = true;
        double sharpness = 0.0;
        for (int i = 0; i < rank; i++) sharpness += most / (lengths[ids[i]] * abs(row[i][i]));
        sharpness_ = max(sharpness_, sharpness);
        double *z = arena_.doubles(s), *gap = arena_.doubles(n);
        for (int again = 0; again < 2; again++) {
            clear(z, s);
            for (int i = 0; i < n; i++) gap[i] = gaps[ids[i]] - dot(normals + size_t(ids[i]) * stride, y, r);
            if (rank < n) balance_gaps(row, gap, n, rank, z);
            for (int i = 0; i < rank && rank == n; i++) z[i] = (gap[i] - dot(row[i], z, i)) / row[i][i];
            chain.apply_reversed(z);
            for (int j = 0; j < r; j++) y[j] += z[j];
        }
    }

    // z (rank) := what meets the gaps of n rows best, which may have no step in common.
    void balance_gaps(double* const* row, const double* gap, int n, int rank, double* z) {
        Scope scope(arena_);
        const int s = padded(n);
        double* columns = arena_.zeros(size_t(rank + 1) * s);
        int* order = arena_.array<int>(rank);
        for (int j = 0; j < rank; j++)
            for (int i = j; i < n; i++) columns[size_t(j) * s + i] = row[i][j];
        double* side = columns + size_t(rank) * s;
        copy(gap, side, n);
        column_qr(columns, s, rank + 1, rank, n, order, true, arena_);
        Triangle{columns, s, rank}.solve(side);
        for (int j = 0; j < rank; j++) z[order[j]] = side[j];
    }

    // ------------------------------------------------------------------------------------------------------ slacks and scale

    double broken_at_start() {
        double worst = 0.0;
        start_ = arena_.zeros(stride);
        if (equalities_) out_of(begin_, start_);
        slacks(start_, slack_);
        for (int i = 0; i < all_; i++) worst = min(worst, slack_[i]);
        return -worst;
    }

    void slacks(const double* u, double* slack) {
        for (int j = 0; j < m_; j++) {
            slack[j] = side_[j] - u[j];
            slack[m_ + j] = side_[m_ + j] + u[j];
        }
        for (int k = 2 * m_; k < all_; k++) {
            const int i = k - 2 * m_;
            slack[k] = side_[k] < INFINITE ? side_[k] - dot(normal_ + size_t(i) * stride, u, stride) : INFINITE;
        }
    }

    // Slacks at u_, the worst of them, and what figures of u_ are relative to, see Hierarchy.scale.
    void measure() {
        slacks(u_, reach_);
        worst_hard_ = least(reach_, hard_);
        worst_ = min(worst_hard_, least(reach_ + hard_, all_ - hard_));
        size_ = norm(u_, m_);
        scale_ = size_;
        const double least = max(broken_, asked());
        if (size_ > tol_.FLOOR * max(closed_form_ < 0.0 ? longest_ : closed_form_, least) && size_ > 0.0) return;
        const double likely = max(closed_form_length(), least);
        Scope scope(arena_);
        double *positive = arena_.doubles(all_), *slack = arena_.doubles(all_), length = likely;
        int n = 0;
        slacks(start_, slack);
        for (int i = 0; i < all_; i++)
            if (slack[i] > 0.0 && slack[i] < INFINITE) positive[n++] = slack[i];
        if (n) {
            std::nth_element(positive, positive + n / 2, positive + n);
            length = min(length, positive[n / 2]);
        }
        scale_ = max(size_, tol_.FLOOR * (length > 0.0 ? length : 1.0));
    }

    // The shortest step that could give any level what it asks for, see Hierarchy._asked.
    double asked() const {
        double least = 0.0;
        for (int l = 0; l < now_.levels; l++) {
            const Block& block = levels_[l];
            if (block.is_soft || !(block.demand > 0.0)) continue;
            double strength = 0.0;
            for (int i = 0; i < block.n; i++) strength += block.root[i] * block.root[i] * block.length[i] * block.length[i];
            if (strength > 0.0) least = max(least, block.demand / sqrt(strength));
        }
        return least;
    }

    // The length of the closed form, worked out when a step is so short that it matters.
    double closed_form_length() {
        if (closed_form_ < 0.0) {
            Scope scope(arena_);
            double *u = arena_.doubles(stride), *x = arena_.doubles(stride);
            const bool doubt = doubt_, weak = is_weak_;
            copy(u_, u, stride);
            copy(x_, x, stride);
            face(nullptr, 0);
            closed_form_ = norm(u_, m_);
            copy(u, u_, stride);
            copy(x, x_, stride);
            doubt_ = doubt;
            is_weak_ = weak;
        }
        return closed_form_;
    }

    double *u_ = nullptr, *x_ = nullptr, *reach_ = nullptr, *slack_ = nullptr, *start_ = nullptr;
    double closed_form_ = 0.0, broken_ = 0.0, worst_ = 0.0, worst_hard_ = 0.0, size_ = 0.0, scale_ = 0.0;
    bool doubt_ = false;    // whether a row may count or not
    bool is_weak_ = false;  // whether rows that hold nearly say the same, so that they decide the step to few digits
    double sharpness_ = 0.0;  // how far the step moves at most, a unit by which rows that hold do
    double* drift_ = nullptr;       // of inequalities in x, where they have any
    int* settled_from_ = nullptr;   // the coordinate from which on an inequality counts for nothing, m if none

  private:
    // What `part` leaves to `meet_parted`.
    struct Parted {
        bool is_used = false;
        Reflectors chain;
        double** row = nullptr;            // the triangle of the rows that come first,
        int count = 0;                     // and how many combinations of all there are,
        double* shares = nullptr;          // of how much of each row,
        double* combinations = nullptr;    // what they are,
        double* sides = nullptr;           // and are to be
    };

    Reflectors small_chain_;
    Parted parted_;
    double* carried_ = nullptr;
    int* shares_ = nullptr;  // by level, and one more: how many rows it and the levels below meet
    uint8_t *is_carried_ = nullptr, *in_doubt_ = nullptr;
};

}  // namespace prioritized_ik
