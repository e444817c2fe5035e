// The fourth layer: a level's gradient and rows with twice the digits of doubles, for proofs whose doubles have not those that
// decide; see balance.py, which has fewer.
#pragma once

#include <tuple>
#include <utility>

#include "double_double.hpp"
#include "face.hpp"

namespace prioritized_ik {

class Extended : public Face {
  protected:
    using Face::Face;

    static constexpr double FINER = 1.0 / (1ull << 45);  // than the rounding of doubles: seven bits are left for long sums

    Doubled doubled(size_t n) {
        double* high = arena_.zeros(n);
        return {high, arena_.zeros(n)};
    }

    // Room for the directions of one proof.
    void start_looks() {
        directions_ = arena_.doubles(size_t(m_) * stride);
        has_directions_ = false;
    }

    // The direction in u of each coordinate of x, a row each: the columns of V.
    const double* directions() {
        if (has_directions_) return directions_;
        Scope scope(arena_);
        double** turned = arena_.array<double*>(m_);
        for (int i = 0; i < m_; i++) {
            turned[i] = arena_.zeros(stride);
            turned[i][i] = 1.0;
        }
        chain_.apply(turned, m_);
        clear(directions_, size_t(m_) * stride);
        for (int j = 0; j < m_; j++)
            for (int i = 0; i < m_; i++) directions_[size_t(j) * stride + i] = turned[i][place_[j]];
        has_directions_ = true;
        return directions_;
    }

    // What a level feels, as directions in u in which its cost is |.|^2, a row each.
    void felt_of(const Block& block, double* felt) {
        const double* own = directions() + size_t(block.start) * stride;
        for (int j = 0; j < block.rank; j++)
            add_rows(block.inverse + size_t(j) * block.R.stride, own, stride, j + 1, felt + size_t(j) * stride, stride);
    }

    // A level's rows; where its rank is cut by more than rounding, without what is cut.
    const double* const* counted(const Block& block) {
        if (!block.is_cut) return block.row;
        const double** rows = arena_.array<const double*>(block.n);
        const double* all = directions();
        for (int i = 0; i < block.n; i++) {
            double* row = arena_.doubles(stride);
            copy(block.row[i], row, stride);
            for (int j = block.end(); j < m_; j++)
                add(-dot(block.row[i], all + size_t(j) * stride, stride), all + size_t(j) * stride, row, stride);
            rows[i] = row;
        }
        return rows;
    }

    // x (stride) := x without what a level feels of it.
    void leave_unfelt(const Block& block, const double* const* rows, const double* felt, Doubled x) {
        Scope scope(arena_);
        const Doubled gradient = doubled(stride);
        for (int i = 0; i < block.n; i++) add(block.weight[i] * dot(rows[i], x, stride), rows[i], gradient, stride);
        for (int j = 0; j < block.rank; j++) {
            const double* direction = felt + size_t(j) * stride;
            add(-dot(direction, gradient, stride), direction, x, stride);
        }
    }

    // x (stride) := x without what equalities feel of it.
    void leave_equalities(Doubled x) {
        Scope scope(arena_);
        const int n = equalities_, r = levels_.empty() || !now_.levels ? rest_ : levels_[0].start, s = padded(n);
        double* columns = arena_.zeros(size_t(r + 1) * s);
        int* order = arena_.array<int>(r);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < r; j++)
                columns[size_t(j) * s + i] = dot(equal_as_given_[i], directions() + size_t(j) * stride, stride);
            columns[size_t(r) * s + i] = dot(equal_as_given_[i], x, stride).rounded();
        }
        column_qr(columns, s, r + 1, r, n, order, true, arena_);
        double* side = columns + size_t(r) * s;
        Triangle{columns, s, r}.solve(side);
        for (int j = 0; j < r; j++) add(DoubleDouble{-side[j]}, directions() + size_t(order[j]) * stride, x, stride);
    }

    // Takes from directions (v rows of stride) what equalities and the first `above` levels feel of them by rounding. Returns how
    // far they still are from what these leave, as angles: for rows, and for levels. Nothing is left but the rounding of this,
    // once more rounded; where a metric rounded the rows, half a unit in their last place, which turns rows by as much by itself.
    // If a level is cut by more than rounding, for rows all that may be, `blur`, and for levels, to which what was cut is none,
    // `as_given`.
    std::pair<double, double> leave_above(int above, Doubled x, int v, double blur, double as_given) {
        double left = as_given * as_given;
        bool is_cut = false;
        for (int j = 0; equalities_ && j < v; j++) leave_equalities(x.from(size_t(j) * stride));
        if (equalities_) left = max(left, finest() / equalities_weakest_);
        for (int l = 0; l < above; l++) {
            const Block& block = levels_[l];
            is_cut = is_cut || block.is_cut;
            if (!block.rank || block.is_soft || block.is_cut) continue;
            left = max(left, finest() / block.weakest);
            Scope scope(arena_);
            double* felt = arena_.zeros(size_t(block.rank) * stride);
            felt_of(block, felt);
            for (int j = 0; j < v; j++) leave_unfelt(block, block.row, felt, x.from(size_t(j) * stride));
        }
        left = min(as_given, left);
        return {max(is_cut ? blur : left, is_rounded_ ? finest() : 0.0), is_cut ? as_given : left};
    }

    // How far a row is from the one that was given, relative to its length, or is taken to be.
    double finest() const { return is_rounded_ ? 0.5 * tol_.EPS : tol_.ROUNDING * FINER; }

    // The gradient of a level's cost along directions (r rows of stride), and what rounding can feign of it; of the last level's
    // without block. Rows that were rounded once turn what they lack towards directions that the level hardly feels.
    void gradient_along(Doubled exact, int r, const Block* block, const double* const* rows, Doubled gradient, double* blur) {
        Scope scope(arena_);
        const Doubled slope = doubled(stride), at{u_, arena_.zeros(stride)};
        double *sizes = arena_.zeros(stride), strength = 0.0, turned = 0.0;
        if (block) {
            for (int i = 0; i < block->n; i++) {
                const double *row = rows[i], weight = block->weight[i];
                double size = abs(block->side[i]);
                for (int j = 0; j < m_; j++) size += abs(row[j] * u_[j]);
                const DoubleDouble lacking = dot(row, at, stride) + DoubleDouble{-block->side[i]};
                add(weight * lacking, row, slope, stride);
                for (int j = 0; j < m_; j++) sizes[j] += weight * size * abs(row[j]);
                const double square = dot(row, row, stride);
                strength += weight * square;
                turned += weight * abs(lacking.high) * sqrt(square);
            }
        } else {
            for (int j = 0; j < m_; j++) {
                slope.set(j, DoubleDouble{u_[j]} + DoubleDouble{-reference_[j]});
                sizes[j] = abs(u_[j]) + abs(reference_[j]);
            }
        }
        for (int j = 0; j < r; j++) {
            const Doubled direction = exact.from(size_t(j) * stride);
            gradient.set(j, dot(direction, slope, stride));
            blur[j] = is_rounded_ ? finest() * (sqrt(strength) * size_ + norm(direction.high, stride) * turned) : 0.0;
            for (int k = 0; k < m_; k++) blur[j] += tol_.ROUNDING * FINER * abs(direction.high[k]) * sizes[k];
        }
    }

    // An inequality along `exact` directions (v rows of stride), those of coordinates from `start` on, and its length: as it is
    // given, as its own rounding would count, and nothing where the levels above settle it.
    double along(int id, Doubled exact, int start, int v, Doubled normal) {
        double length = 1.0;
        const double* row = nullptr;
        if (id >= 2 * m_) std::tie(row, length) = as_given(id);
        for (int j = 0; j < v; j++) {
            const Doubled direction = exact.from(size_t(j) * stride);
            if (start + j >= settled_from_[id]) normal.set(j, DoubleDouble{0.0});
            else normal.set(j, row ? dot(row, direction, stride) : id < m_ ? direction[id] : -direction[id - m_]);
        }
        return length;
    }

  private:
    double* directions_ = nullptr;
    bool has_directions_ = false;
};

}  // namespace prioritized_ik
