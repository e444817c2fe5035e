// The seventh layer: a guess of the active rows by a dual active-set method, from the closed form on.
//
// With each level weighed far less than the one above, all levels are one cost |z|^2, z_l = w_l (R_l x_l + M_l x_<l - c_l),
// and the closed form is z = 0. From there the method of Goldfarb and Idnani (1983, A numerically stable dual method for
// solving strictly convex quadratic programs) holds the row that is broken most, and lets go those whose multipliers vanish on the
// way: one small update of a QR decomposition each, in place of a whole face. A row of a soft level has one coordinate
// more, by which it gives way. The guess is no answer: weights are finite, and `search` goes on from it.
#pragma once

#include "written.hpp"

namespace prioritized_ik {

class DualGuess : public Written {
  protected:
    using Written::Written;

    // Finds the active and exceeded rows from the closed form, in u_ with its slacks in reach_, which move along; holds
    // those of `io.guess` first if `is_warm`. Whether it ended.
    bool guess_by_multipliers(bool is_warm) {
        Scope scope(arena_);
        if (!begin()) return false;
        if (is_warm) hold_guessed();
        int changes = CHANGES * width_;
        for (int p = most_broken(); p >= 0; p = most_broken())
            if (!hold_broken(p, changes)) return false;
        for (int j = 0; j < held_; j++)
            if (const int i = ids_of_[j]; lambda_[j] * gives(i) > EXCEEDS * scale_) exceeded_[i] = 1, active_[i] = 0;
        return true;
    }

  private:
    static constexpr int CHANGES = 4;  // of the set, a coordinate: most need a few in all
    // What a level's strongest direction weighs beside the weakest one above: so little that levels above hardly give way,
    // but for many levels more, so that the last of them is not lost in rounding.
    static constexpr double STEEPEST = 1e-3, FLATTEST = 0.1, LEAST_WEIGHT = 1e-15;
    static constexpr double CLEAR = 1e-6;  // of a level's strongest direction: weaker ones are lost among weighed levels
    static constexpr double TINY = 1e-75;        // weights whose fourth powers are no numbers
    static constexpr double EXCEEDS = 1e-4;      // of the scale: rows that can be kept give way far less
    static constexpr double INDEPENDENT = 1e-9;  // of a coordinate's terms: what others leave of a row, and is not rounding

    bool begin() {
        width_ = padded(m_ + soft_);
        const int most = m_ + soft_ + 1;
        whitened_ = arena_.doubles(size_t(all_) * width_);
        is_whitened_ = arena_.array<uint8_t>(all_);
        basis_ = arena_.doubles(size_t(most) * width_);
        R_ = Triangle{arena_.doubles(size_t(most) * width_), width_, 0};
        lambda_ = arena_.doubles(most);
        combination_ = arena_.doubles(most);
        residual_ = arena_.doubles(width_);
        terms_ = arena_.doubles(width_);
        ids_of_ = arena_.array<int>(most);
        weight_ = arena_.doubles(now_.levels + 1);
        std::memset(is_whitened_, 0, all_);
        std::memset(active_, 0, all_);
        held_ = 0;
        double range = 1.0, weight = 1.0;
        int count = 0;
        for (int l = 0; l < now_.levels; l++)
            if (const auto [strongest, weakest] = felt(levels_[l]); strongest > 0.0) {
                if (weakest < CLEAR * strongest) return false;
                range *= weakest / strongest, count++;
            }
        const double fades = max(STEEPEST, min(FLATTEST, std::pow(LEAST_WEIGHT / range, 1.0 / max(1, count))));
        for (int l = 0; l < now_.levels; l++) {
            const auto [strongest, weakest] = felt(levels_[l]);
            weight_[l] = strongest > 0.0 ? weight / strongest : 1.0;
            if (strongest > 0.0) weight = fades * weight_[l] * weakest;
        }
        weight_[now_.levels] = weight;
        return weight > TINY;
    }

    // The most and the least that a level feels of its directions, or of its rows where it is soft; zero if nothing.
    std::pair<double, double> felt(const Block& block) const {
        double strongest = block.strength, weakest = block.rank ? 1.0 / block.inverse_norm : INFINITE;
        for (int i = block.soft_start; block.is_soft && i < block.soft_start + block.given; i++)
            if (side_[i] < INFINITE) strongest = max(strongest, strength(i)), weakest = min(weakest, strength(i));
        return {strongest, weakest};
    }

    // How much a soft level feels of its row i of unit length.
    double strength(int i) const {
        const Block& block = levels_[level_of_[i]];
        const int from = block.first + i - block.soft_start;
        return sqrt(io.weights[from]) * lengths_[from];
    }

    // How far a row gives way, of its multiplier.
    double gives(int i) const {
        if (i < hard_) return 0.0;
        const double root = weight_[level_of_[i]] * strength(i);
        return 1.0 / (root * root);
    }

    // --------------------------------------------------------------------------------------------- rows and steps in z

    // A row in z.
    const double* whitened(int i) {
        double* row = whitened_ + size_t(i) * width_;
        if (is_whitened_[i]) return row;
        is_whitened_[i] = 1;
        carry(&i, 1);
        Scope scope(arena_);
        const int first = start_of(0);
        double *own = arena_.doubles(stride), *felt = arena_.doubles(stride);
        copy(carried(i), row, m_);
        clear(row + m_, width_ - m_);
        clear(row, first);
        for (int j = rest_; j < m_; j++) row[j] /= weight_[now_.levels];
        for (int l = now_.levels; l-- > 0;) {
            const Block& block = levels_[l];
            const int c = block.start, r = block.rank, s = block.R.stride, n = padded(r);
            copy(row + c, own, r);
            clear(own + r, n - r);
            dots(block.inverse, s, r, own, felt, n);
            clear(felt + r, n - r);
            dots(block.above + size_t(first) * s, s, c - first, felt, own, n);
            for (int j = first; j < c; j++) row[j] -= own[j - first];
            for (int j = 0; j < r; j++) row[c + j] = felt[j] / weight_[l];
        }
        if (i >= hard_) row[m_ + i - hard_] = sqrt(gives(i));
        return row;
    }

    // u_ moves by `part` of a move in z, and the slacks with it.
    void move(double part, const double* z) {
        Scope scope(arena_);
        double *x = arena_.zeros(stride), *own = arena_.doubles(stride), *solved = arena_.doubles(stride);  // x: of -z
        const int first = start_of(0);
        for (int l = 0; l < now_.levels; l++) {
            const Block& block = levels_[l];
            const int c = block.start, r = block.rank, s = block.R.stride, n = padded(r);
            for (int j = 0; j < r; j++) own[j] = z[c + j] / weight_[l];
            clear(own + r, n - r);
            add_rows(x + first, block.above + size_t(first) * s, s, c - first, own, n);
            clear(solved, n);
            add_rows(own, block.inverse, s, r, solved, n);
            for (int j = 0; j < r; j++) x[c + j] = -solved[j];
        }
        for (int j = rest_; j < m_; j++) x[j] = -z[j] / weight_[now_.levels];
        double* step = own;
        out_of(x, step);
        add(-part, step, u_, stride);
        slacks(u_, reach_);
    }

    // --------------------------------------------------------------------------------------------- the rows that are held

    // Holds those guessed rows whose multipliers are not negative.
    void hold_guessed() {
        int *ids = arena_.array<int>(all_), t = 0;
        for (int i = 0; i < all_; i++)
            if (io.guess[i] && side_[i] < INFINITE) ids[t++] = i;
        carry(ids, t);
        for (int k = 0; k < t; k++)
            if (const double square = project(ids[k]); square > 0.0) hold(ids[k], 0.0, sqrt(square));
        while (held_) {
            for (int j = 0; j < held_; j++) lambda_[j] = -reach_[ids_of_[j]];
            R_.size = held_;
            R_.solve_transposed(lambda_);
            copy(lambda_, combination_, held_);
            R_.solve(lambda_);
            const double* least = std::min_element(lambda_, lambda_ + held_);
            if (*least >= 0.0) break;
            let_go(int(least - lambda_));
        }
        clear(residual_, width_);
        add_rows(combination_, basis_, width_, held_, residual_, width_);
        move(-1.0, residual_);
    }

    int most_broken() const {
        int found = -1;
        double most = -tol_.KEPT * scale_;
        for (int i = 0; i < all_; i++)
            if (reach_[i] < most && !active_[i]) most = reach_[i], found = i;
        return found;
    }

    // Holds row p, and lets go those whose multipliers vanish on the way; false if there is none such where p depends on
    // others, or after too many `changes`.
    bool hold_broken(int p, int& changes) {
        for (double lambda = 0.0; changes-- > 0;) {
            const double square = project(p);
            copy(R_.column(held_), combination_, held_);
            R_.solve_leading(combination_, held_);
            const int first = first_to_vanish();
            const double least = first < held_ ? lambda_[first] / combination_[first] : INFINITE;
            const double full = square > 0.0 ? max(-reach_[p] - lambda * gives(p), 0.0) / square : INFINITE;
            const double part = min(least, full);
            if (!(part < INFINITE)) return false;
            for (int j = 0; j < held_; j++) lambda_[j] -= part * combination_[j];
            lambda += part;
            if (square > 0.0) move(-part, residual_);
            if (full <= least) {
                hold(p, lambda, sqrt(square));
                return true;
            }
            let_go(first);
        }
        return false;
    }

    // residual_ := what of row p is left beside those that are held, and the next column of R what is in it of their basis.
    // Returns the square of what is left, zero if that is rounding. Twice: where little is left, the first time leaves as
    // much rounding.
    double project(int p) {
        const double* row = whitened(p);
        double* sum = R_.column(held_);
        copy(row, residual_, width_);
        for (int c = 0; c < width_; c++) terms_[c] = abs(row[c]);
        clear(sum, held_);
        for (int twice = 0; twice < 2; twice++) {
            dots(basis_, width_, held_, residual_, combination_, width_);
            for (int j = 0; j < held_; j++) {
                const double *direction = basis_ + size_t(j) * width_, part = combination_[j] = -combination_[j];
                if (!twice) add_sizes(part, direction, terms_, width_);
                sum[j] -= part;
            }
            add_rows(combination_, basis_, width_, held_, residual_, width_);
        }
        for (int c = 0; c < width_; c++)
            if (abs(residual_[c]) > INDEPENDENT * terms_[c]) return dot(residual_, residual_, width_);
        return 0.0;
    }

    // Which of the multipliers vanishes first as the combination grows; how many there are if none does.
    int first_to_vanish() const {
        int first = held_;
        const auto is_sooner = [&](int j) { return lambda_[j] * combination_[first] < lambda_[first] * combination_[j]; };
        for (int j = 0; j < held_; j++)
            if (combination_[j] > 0.0 && (first == held_ || is_sooner(j))) first = j;
        return first;
    }

    // Holds row p, that was projected to a residual of this length.
    void hold(int p, double lambda, double length) {
        double* direction = basis_ + size_t(held_) * width_;
        for (int j = 0; j < width_; j++) direction[j] = residual_[j] / length;
        R_.column(held_)[held_] = length;
        active_[p] = 1;
        ids_of_[held_] = p;
        lambda_[held_++] = lambda;
    }

    // Lets a row go: rotations make a triangle of what is left.
    void let_go(int place) {
        active_[ids_of_[place]] = 0;
        held_--;
        for (int j = place; j < held_; j++) {
            ids_of_[j] = ids_of_[j + 1];
            lambda_[j] = lambda_[j + 1];
            copy(R_.column(j + 1), R_.column(j), j + 2);
        }
        for (int j = place; j < held_; j++) {
            const double a = R_.column(j)[j], b = R_.column(j)[j + 1], size = std::hypot(a, b), c = a / size, s = b / size;
            const auto rotate = [&](double& one, double& other) {
                const double before = one;
                one = c * before + s * other;
                other = c * other - s * before;
            };
            for (int i = j; i < held_; i++) rotate(R_.column(i)[j], R_.column(i)[j + 1]);
            double *one = basis_ + size_t(j) * width_, *other = one + width_;
            for (int i = 0; i < width_; i++) rotate(one[i], other[i]);
        }
    }

    int width_ = 0, held_ = 0;      // coordinates of z, padded; rows that are held,
    int* ids_of_ = nullptr;         // their numbers,
    double* lambda_ = nullptr;      // and their multipliers
    double* basis_ = nullptr;       // orthonormal, of these rows in z,
    Triangle R_{};                  // and what they are of it
    double* whitened_ = nullptr;    // rows in z, those that were asked for
    uint8_t* is_whitened_ = nullptr;
    double* weight_ = nullptr;      // of the levels, and of what none decides
    double *residual_ = nullptr, *terms_ = nullptr, *combination_ = nullptr;  // of the row that was projected last
};

}  // namespace prioritized_ik
