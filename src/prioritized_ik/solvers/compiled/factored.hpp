// The second layer: one factorisation for all levels, and changes of place; see hierarchy.py and level_decomposition.
//
// Coordinates: u = V x in the joint metric, V a chain of reflectors: first what the equalities decide, then one block of x a
// level, then the rest. A row g of u is the row g V of x. Level l asks for R_l x_l + M_l x_<l = c_l in least squares, in
// orthonormal coordinates of its weighted rows.
#pragma once

#include "posed.hpp"
#include "singular_values.hpp"

namespace prioritized_ik {

class Factored : public Posed {
  public:
    Factored(const Sizes& sizes, const Tolerances& tolerances) : Posed(sizes, tolerances), factors_(arena_size(sizes)) {}

  protected:

    void factor() {
        factors_.back_to(0);
        take_rows();
        rows_ = equalities_;
        for (int l = 0; l < now_.levels; l++) rows_ += levels_[l].n;
        double* work = factors_.doubles(size_t(rows_) * stride);
        double** row = factors_.array<double*>(rows_);
        for (int i = 0; i < rows_; i++) row[i] = work + size_t(i) * stride;
        const int most = 2 * m_ + 1;
        chain_.reset(factors_.doubles(size_t(most) * stride), most, stride);
        place_ = factors_.array<int>(m_);
        for (int j = 0; j < m_; j++) place_[j] = j;
        begin_ = factors_.zeros(stride);

        // Rows of unit length where only rounding is cut, as given where the rank tolerance cuts, as in level_decomposition.
        int at = equalities_;
        for (int l = 0; l < now_.levels; l++) {
            Block& block = levels_[l];
            for (int i = 0; i < block.n; i++, at++) {
                copy(block.row[i], row[at], stride);
                if (block.rank_tolerance == 0.0) {
                    const double scale = 1.0 / block.length[i];
                    for (int j = 0; j < stride; j++) row[at][j] *= scale;
                }
            }
        }
        int c = factor_equalities(row);
        lowest_ = max(noise_, tol_.SETTLED_PER_RANK_TOLERANCE * rank_tolerance_);
        double settled = lowest_;
        turned_ = 0.0;
        longest_ = norm(begin_, m_);
        at = equalities_;
        for (int l = 0; l < now_.levels; l++) {
            Block& block = levels_[l];
            block.start = c;
            for (int i = 0; i < block.n; i++) block.order[i] = i;
            factor_level(block, row + at, rows_ - at, settled);
            settled = block.settled;
            turned_ = max(turned_, block.blur);
            longest_ += block.inverse_norm * (block.demand + block.reach * longest_);
            c += block.rank;
            at += block.n;
        }
        rest_ = c;
        settled_ = settled;
    }

    int factor_equalities(double** row) {
        const int n = equalities_;
        if (!n) return 0;
        int* ids = factors_.array<int>(n);
        for (int i = 0; i < n; i++) {
            ids[i] = i;
            copy(equal_ + size_t(i) * stride, row[i], stride);
        }
        double left;
        // Those that say what others say are kept with them, or else the certificate sees it.
        const int r = row_pivoted_lq(row, ids, n, rows_, 0, m_, stride, chain_, tol_.EMPTY, left, arena_);
        equalities_weakest_ = lower_bound(row, r, 0);
        if (!(equalities_weakest_ > tol_.WEAKEST)) throw Declined{EQUALITIES};
        for (int i = 0; i < r; i++) begin_[i] = (equal_side_[ids[i]] - dot(row[i], begin_, i)) / row[i][i];
        return r;
    }

    // A lower bound of the smallest singular value of the leading r x r triangle of rows from column c on.
    double lower_bound(double* const* row, int r, int c) {
        Scope scope(arena_);
        const int s = padded(r);
        double *inverse = arena_.doubles(size_t(r) * s), sum = 0.0;
        for (int i = 0; i < r; i++) {
            double* x = inverse + size_t(i) * s;
            const double* own = row[i] + c;
            clear(x, s);
            add_rows(own, inverse, s, i, x, padded(i));
            const double scale = 1.0 / own[i];
            for (int j = 0; j < i; j++) x[j] *= -scale;
            x[i] = scale;
            sum += dot(x, x, i + 1);
        }
        return 1.0 / sqrt(sum);
    }

    // The same of a triangle with this inverse where x is taken off its coordinates: what it still reaches is orthogonal to
    // R^-T x, and without that R^-1 is the pseudoinverse. Changes the inverse.
    double lower_bound_without(const double* x, const Triangle& R, double* inverse) {
        Scope scope(arena_);
        const int r = R.size, s = R.stride;
        double *unreached = arena_.doubles(r), *taken = arena_.zeros(s), sum = 0.0;
        copy(x, unreached, r);
        R.solve_transposed(unreached);
        const double scale = 1.0 / norm(unreached, r);
        for (int j = 0; j < r; j++) unreached[j] *= scale;
        add_rows(unreached, inverse, s, r, taken, s);
        for (int j = 0; j < r; j++) {
            double* column = inverse + size_t(j) * s;
            add(-unreached[j], taken, column, r);
            sum += dot(column, column, r);
        }
        return 1.0 / sqrt(sum);
    }

    void factor_level(Block& block, double** row, int all, double settled) {
        const int c = block.start, n = block.n;
        double top = 0.0, frobenius = 0.0, left = 0.0;
        for (int i = 0; i < n; i++) {
            const double size = block.rank_tolerance == 0.0 ? 1.0 : block.length[i], square = size * size;
            top = max(top, square);
            frobenius += square;
        }
        top = sqrt(top);
        frobenius = sqrt(frobenius);
        int r = row_pivoted_lq(row, block.order, n, all, c, m_, stride, chain_, tol_.EMPTY * top, left, arena_);
        const int before = r;
        r = cut(block, row, all, r, top, frobenius, settled);
        block.rank = r;
        block.is_cut = r < before && block.rank_tolerance > 0.0;
        // How far rounding may have turned the directions below; `weakest` is a bound from below.
        block.blur = r && !block.is_soft ? tol_.PROJECTION * tol_.EPS / block.weakest : 0.0;
        block.settled = max(settled, block.blur);
        whiten(block, row, before == r && (n == r || r >= MANY));
    }

    // Cuts a level's r coordinates to its rank; `weakest` becomes what the weakest one kept measures at least.
    int cut(Block& block, double** row, int all, int r, double top, double frobenius, double settled) {
        const int c = block.start, n = block.n;
        const bool rounding = block.rank_tolerance == 0.0;
        const double limit = rounding ? max(noise_, settled) : max(block.rank_tolerance, noise_);
        const auto is_clear = [&](double bound) {  // the smallest singular value is at least so much
            block.weakest = rounding ? bound : bound / frobenius;
            return block.weakest > (rounding ? tol_.WEAKEST : limit);
        };
        if (r && is_clear(lower_bound(row, r, c))) return r;
        while (r > 0) {
            Scope scope(arena_);
            const int s = padded(n);
            double *columns = arena_.zeros(size_t(r) * s), *x = arena_.doubles(padded(r)), *y = arena_.doubles(padded(r));
            int* order = arena_.array<int>(r);
            for (int i = 0; i < n; i++)
                for (int j = 0; j < r; j++) columns[size_t(j) * s + i] = row[i][c + j];
            column_qr(columns, s, r, r, n, order, false, arena_);
            const Triangle R{columns, s, r};
            double* inverse = arena_.doubles(size_t(r) * s);
            R.invert(inverse);
            if (is_clear(1.0 / norm(inverse, r * s))) return r;
            const double least = smallest_singular(R, rounding ? tol_.MARGIN * noise_ : limit * top, x, arena_);
            if (least < 0.0) throw Declined{RANK};
            double relative = least;
            if (!rounding) {
                // Bounded from both sides by lengths of rows; the norm itself is worked out only where these leave it open.
                const double enough = least / limit;
                relative = least / frobenius;
                if (!(relative > limit)) {
                    const double largest = top > enough * (1.0 + tol_.CUT_MARGIN) ? top : largest_singular(block.row, n, m_, stride, enough, arena_);
                    if (largest < 0.0) throw Declined{RANK};
                    relative = least / largest;
                }
            }
            if (rounding) {
                // Where a level is this weak, rounding turns the directions below: Python looks closer.
                if (relative > tol_.WEAKEST) {
                    block.weakest = relative;
                    return r;
                }
                if (!(relative < tol_.MARGIN * noise_)) throw Declined{RANK};
            } else if (abs(relative - limit) <= tol_.CUT_MARGIN * limit) {
                throw Declined{RANK};
            } else if (relative > limit) {
                block.weakest = relative;
                return r;
            }
            // Sends x to the block's last coordinate, which joins those below.
            for (int j = 0; j < r; j++) y[j] = x[r - 1 - j];
            double tau, *v = chain_.next(c);
            reflector(y, y, r, tau);
            for (int j = 0; j < r; j++) v[c + j] = y[r - 1 - j];
            const int from = aligned_start(c);
            reflect_all(row, all, from, v + from, tau, stride - from);
            chain_.keep(tau);
            if (--r && is_clear(lower_bound_without(x, R, inverse))) return r;
        }
        block.weakest = 1.0;
        return 0;
    }

    // Coordinates from which on a triangle is not given up for pivots, which grade what is weak: certificates of small levels
    // are the sharper for it.
    static constexpr int MANY = 16;

    // W^1/2 A in the level's coordinates becomes Q R; the same Q for what the levels above decide, and for the target. Where the
    // rank is not cut, the first rows are a lower `triangle`: read from its end, it is an upper one.
    void whiten(Block& block, double* const* row, bool triangle) {
        const int c = block.start, r = block.rank, n = block.n, s = padded(max(n, 1)), k = r + c + 1;
        double* columns = factors_.zeros(size_t(k) * s);
        double* factor = factors_.doubles(n);
        block.demand = 0.0;
        for (int i = 0; i < n; i++) {
            const int id = block.order[i];
            factor[i] = block.root[id] * (block.rank_tolerance == 0.0 ? block.length[id] : 1.0);
            const double side = block.root[id] * block.side[id];
            block.demand += side * side;
        }
        block.demand = sqrt(block.demand);
        block.R = Triangle{columns, s, r};
        block.above = columns + size_t(r) * s;
        block.reflectors = nullptr;
        int* turned = factors_.array<int>(r);
        for (int i = 0; i < n; i++) {
            const int at = triangle && i < r ? r - 1 - i : i;
            for (int j = 0; j < (triangle ? min(i + 1, r) : r); j++)
                columns[size_t(triangle ? r - 1 - j : j) * s + at] = factor[i] * row[i][c + j];
            for (int j = 0; j < c; j++) block.above[size_t(j) * s + at] = factor[i] * row[i][place_[j]];
            block.target()[at] = block.root[block.order[i]] * block.side[block.order[i]];
        }
        if (n > r) {
            block.reflectors = factors_.doubles(size_t(r) * s);
            block.taus = factors_.doubles(r);
        }
        if (triangle) {
            for (int j = 0; j < r; j++) turned[j] = r - 1 - j;
            std::reverse(block.order, block.order + r);
            if (n > r) triangle_qr(columns, s, k, r, n, factors_, block.reflectors, block.taus);
        } else {
            column_qr(columns, s, k, r, n, turned, true, factors_, block.reflectors, block.taus);
        }
        for (int j = 0; j < r; j++) place_[c + j] = c + turned[j];
        block.inverse = factors_.doubles(size_t(r) * s);
        block.sizes = factors_.doubles(r);
        block.R.invert(block.inverse);
        block.shortest = INFINITE;
        block.longest = 0.0;
        double strength = 0.0, inverse = 0.0;
        for (int j = 0; j < r; j++) {
            strength += dot(block.R.column(j), block.R.column(j), j + 1);
            block.sizes[j] = norm(block.inverse + size_t(j) * s, j + 1);
            inverse += block.sizes[j] * block.sizes[j];
            block.shortest = min(block.shortest, block.sizes[j]);
            block.longest = max(block.longest, block.sizes[j]);
        }
        block.reach = c ? norm(block.above, c * s) : 0.0;
        block.strength = sqrt(strength);
        block.inverse_norm = sqrt(inverse);
        if (!r) block.shortest = 1.0;
    }

    // ---------------------------------------------------------------------------------------------------- changes of place

    // out := g V
    void into(const double* g, double* out) {
        Scope scope(arena_);
        double* turned = arena_.doubles(stride);
        copy(g, turned, stride);
        chain_.apply(&turned, 1);
        for (int j = 0; j < m_; j++) out[j] = turned[place_[j]];
        clear(out + m_, stride - m_);
    }

    // u := V x
    void out_of(const double* x, double* u) {
        clear(u + m_, stride - m_);
        for (int j = 0; j < m_; j++) u[place_[j]] = x[j];
        chain_.apply_reversed(u);
    }

    // Whether rounding may have put a row that moves by so much on the wrong side of `settled`.
    bool may_be_settled(double moves, double settled) const {
        return moves > max(lowest_ / tol_.NEARLY, lowest_ - 2.0 * turned_) &&
               moves < min(settled * tol_.NEARLY, settled + 2.0 * turned_);
    }

    Arena factors_;
    Reflectors chain_;
    int rest_ = 0, *place_ = nullptr;
    double lowest_ = 0.0, settled_ = 0.0, turned_ = 0.0, longest_ = 0.0, *begin_ = nullptr;
    double equalities_weakest_ = 1.0;  // singular value, at least
};

}  // namespace prioritized_ik
