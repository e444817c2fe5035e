// The first layer of a step: the problem in its joint metric, without what is rounding; see IKProblem.in_metric and zero_length.
#pragma once

#include "exchange.hpp"

namespace prioritized_ik {

// One level's rows, and its block of coordinates.
struct Block {
    int first, given, n;       // its rows as given; those that count
    const double** row;        // as given, in the metric (n)
    double *root, *side, *length; // square roots of their weights, targets, and lengths (n)
    int* order;                // of the rows in the factors (n)
    int start, rank;           // its coordinates
    Triangle R;                // upper triangle in these
    double* above;             // M by columns, then c, by R's stride
    double* inverse;           // R^-1 by columns
    double* sizes;             // lengths of these columns
    double *reflectors, *taus; // of the rows' coordinates, where there are any
    bool is_cut;               // by more than rounding
    double strength, reach, inverse_norm, shortest, longest, demand, weakest, settled, blur;
    double* target() const { return above + size_t(start) * R.stride; }
    int end() const { return start + rank; }
};

class Posed {
  public:
    const int stride;
    const Sizes most;
    Exchange io;

    Posed(const Sizes& sizes, const Tolerances& tolerances)
        : stride(padded(sizes.joints)), most(sizes), io(sizes, stride), tol_(tolerances), m_(sizes.joints),
          arena_(arena_size(sizes)), levels_(sizes.levels + 1) {}

  protected:
    double* in_metric(const double* rows, int n) {
        double* scaled = arena_.doubles(size_t(n) * stride);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < m_; j++) scaled[size_t(i) * stride + j] = rows[size_t(i) * stride + j] / io.metric_root[j];
            clear(scaled + size_t(i) * stride + m_, stride - m_);
        }
        return scaled;
    }

    void read() {
        const double* root = io.metric_root.data();
        noise_ = io.settings[1];
        rank_tolerance_ = io.settings[0];
        all_ = 2 * m_ + now_.rows;
        bool plain = true;
        for (int j = 0; j < m_; j++) plain = plain && root[j] == 1.0;
        double *matrix = io.matrix.data(), *rows = io.row_matrix.data(), *fixed = io.equality_matrix.data();
        if (!plain) {
            matrix = in_metric(matrix, now_.level_rows);
            rows = in_metric(rows, now_.rows);
            fixed = in_metric(fixed, now_.equalities);
        }

        // What is this short beside the longest row is rounding, see IKProblem.zero_length.
        double* lengths = arena_.doubles(now_.level_rows + now_.rows + now_.equalities);
        double *hard_lengths = lengths + now_.level_rows, *fixed_lengths = hard_lengths + now_.rows, longest = 1.0;
        for (int i = 0; i < now_.level_rows; i++) longest = max(longest, lengths[i] = norm(matrix + size_t(i) * stride, stride));
        for (int i = 0; i < now_.rows; i++) {
            const bool finite = io.row_upper[i] < INFINITE;
            longest = max(longest, hard_lengths[i] = finite ? norm(rows + size_t(i) * stride, stride) : 0.0);
        }
        for (int i = 0; i < now_.equalities; i++)
            longest = max(longest, fixed_lengths[i] = norm(fixed + size_t(i) * stride, stride));
        shortest_row_ = noise_ * longest;
        zero_ = arena_.array<int>(now_.level_rows + now_.rows);

        read_hard(rows, hard_lengths, plain);
        read_equalities(fixed, fixed_lengths, plain);
        rows_ = equalities_;
        for (int l = 0; l < now_.levels; l++) read_level(l, matrix, lengths);
        reference_ = arena_.zeros(stride);
        has_reference_ = false;
        for (int j = 0; j < m_; j++) {
            reference_[j] = io.reference[j] * root[j];
            has_reference_ = has_reference_ || reference_[j] != 0.0;
        }
    }

    bool is_rounding(double size) const {
        if (abs(size - shortest_row_) <= tol_.CUT_MARGIN * shortest_row_) throw Declined{ROUNDING_ROW};
        return size <= shortest_row_;
    }

    // Hard rows, of unit length, so that slacks are distances; bounds are in the metric already.
    void read_hard(const double* rows, const double* lengths, bool plain) {
        const double* root = io.metric_root.data();
        side_ = arena_.doubles(all_);
        frozen_ = 0;
        normal_ = arena_.doubles(size_t(now_.rows) * stride);
        for (int j = 0; j < m_; j++) {
            const bool frozen = io.lower[j] == io.upper[j];
            frozen_ += frozen;
            side_[j] = frozen ? INFINITE : plain ? io.upper[j] : io.upper[j] * root[j];
            side_[m_ + j] = frozen ? INFINITE : -(plain ? io.lower[j] : io.lower[j] * root[j]);
        }
        for (int i = 0; i < now_.rows; i++) {
            double *to = normal_ + size_t(i) * stride, &side = side_[2 * m_ + i];
            const double* from = rows + size_t(i) * stride;
            side = INFINITE;
            clear(to, stride);
            if (!(io.row_upper[i] < INFINITE)) continue;
            const double size = lengths[i];
            if (size == 0.0) continue;
            if (is_rounding(size)) {
                if (io.row_upper[i] < 0.0) throw Declined{ROUNDING_ROW};
                zero_[io.lists[ZERO]++] = now_.level_rows + i;
                continue;
            }
            add(1.0 / size, from, to, stride);
            side = io.row_upper[i] / size;
        }
    }

    // Equalities, frozen joints first, of unit length.
    void read_equalities(const double* fixed, const double* lengths, bool plain) {
        const int e = frozen_ + now_.equalities;
        equal_ = arena_.zeros(size_t(e) * stride);
        equal_side_ = arena_.doubles(e);
        equalities_ = 0;
        for (int j = 0; j < m_; j++)
            if (io.lower[j] == io.upper[j]) {
                equal_[size_t(equalities_) * stride + j] = 1.0;
                equal_side_[equalities_++] = plain ? io.lower[j] : io.lower[j] * io.metric_root[j];
            }
        for (int i = 0; i < now_.equalities; i++) {
            const double size = lengths[i];
            if (size == 0.0) continue;
            if (is_rounding(size)) throw Declined{ROUNDING_ROW};
            add(1.0 / size, fixed + size_t(i) * stride, equal_ + size_t(equalities_) * stride, stride);
            equal_side_[equalities_++] = io.equality_target[i] / size;
        }
    }

    // A level's rows that mean something, damping among them.
    void read_level(int l, const double* matrix, const double* lengths) {
        Block& block = levels_[l];
        const int first = l ? io.ends[l - 1] : 0, end = io.ends[l], damped = io.damping[l] > 0.0 ? m_ : 0, n = end - first;
        block.first = first;
        block.given = n;
        block.n = 0;
        block.row = arena_.array<const double*>(n + damped);
        block.root = arena_.doubles(n + damped);
        block.side = arena_.doubles(n + damped);
        block.length = arena_.doubles(n + damped);
        block.order = arena_.array<int>(n + damped);
        auto take = [&](const double* row, double weight_root, double length, double side) {
            block.row[block.n] = row;
            block.root[block.n] = weight_root;
            block.length[block.n] = length;
            block.side[block.n++] = side;
        };
        for (int i = first; i < end; i++) {
            const bool little = is_rounding(lengths[i]);
            if (little && lengths[i] > 0.0) zero_[io.lists[ZERO]++] = i;
            if (little || io.weights[i] == 0.0) continue;
            take(matrix + size_t(i) * stride, sqrt(io.weights[i]), lengths[i], io.target[i]);
        }
        if (damped) {
            double* extra = arena_.zeros(size_t(m_) * stride);
            const double strength = sqrt(io.damping[l]);
            if (is_rounding(strength)) throw Declined{ROUNDING_ROW};
            for (int j = 0; j < m_; j++) {
                extra[size_t(j) * stride + j] = strength;
                take(extra + size_t(j) * stride, 1.0, strength, 0.0);
            }
        }
        rows_ += block.n;
    }

    const Tolerances tol_;
    const int m_;
    Sizes now_{};
    Arena arena_;
    std::vector<Block> levels_;

    int all_ = 0, rows_ = 0, equalities_ = 0, frozen_ = 0;
    double noise_ = 0.0, rank_tolerance_ = 0.0, shortest_row_ = 0.0;
    bool has_reference_ = false;
    int* zero_ = nullptr;
    double *side_ = nullptr, *normal_ = nullptr, *equal_ = nullptr, *equal_side_ = nullptr, *reference_ = nullptr;

  private:
    static size_t arena_size(const Sizes& s) {
        const size_t w = padded(s.joints), damped = s.level_rows + size_t(s.levels) * s.joints;
        return (damped + s.equalities + 4 * w + s.rows + 64) * (w + padded(int(damped))) * 2 + 4096;
    }
};

}  // namespace prioritized_ik
