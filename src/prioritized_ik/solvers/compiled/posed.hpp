// The first layer of a step: the problem in its joint metric, without what is rounding; see IKProblem.in_metric and zero_length.
#pragma once

#include "exchange.hpp"

namespace prioritized_ik {

// One level's rows, and its block of coordinates.
struct Block {
    int first, given, n;       // its rows as given; those that count now
    int counting;              // those that count, of soft levels none: the exceeded ones do
    const double** row;        // as given, in the metric (n)
    double *weight, *root, *side, *length; // their weights, square roots of these, targets, and lengths (n)
    int* order;                // of the rows in the factors (n)
    int start, rank;           // its coordinates
    Triangle R;                // upper triangle in these
    double* above;             // M by columns, then c, by R's stride
    double* inverse;           // R^-1 by columns
    double* sizes;             // lengths of these columns
    double *reflectors, *taus; // of the rows' coordinates, where there are any
    bool is_cut;               // by more than rounding
    bool is_soft;              // of soft inequalities: `given` of them, those that count are the exceeded ones
    int soft_start;            // number of its first row among all inequalities
    double rank_tolerance, asked;  // asked: length of all it asks for
    double strength, reach, inverse_norm, shortest, longest, demand, weakest, settled, blur;
    double* target() const { return above + size_t(start) * R.stride; }
    int end() const { return start + rank; }
};

class Posed {
  public:
    const int stride;
    const Sizes most;
    const Sizes& now() const { return now_; }
    void size(const Sizes& now) { now_ = now; }
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
        hard_ = 2 * m_ + now_.rows;
        soft_ = 0;
        looked_at_ = now_.levels;
        for (int l = 0; l < now_.levels; l++) soft_ += io.soft[l] ? io.ends[l] - (l ? io.ends[l - 1] : 0) : 0;
        all_ = hard_ + soft_;
        bool plain = true;
        for (int j = 0; j < m_; j++) plain = plain && root[j] == 1.0;
        double *matrix = io.matrix.data(), *rows = io.row_matrix.data(), *fixed = io.equality_matrix.data();
        is_rounded_ = !plain || io.settings[2] != 0.0;
        if (!plain) {
            matrix = in_metric(matrix, now_.level_rows);
            rows = in_metric(rows, now_.rows);
            fixed = in_metric(fixed, now_.equalities);
        }

        // What is this short beside the longest row is rounding, see IKProblem.zero_length.
        double* lengths = lengths_ = arena_.doubles(now_.level_rows + now_.rows + now_.equalities);
        double *hard_lengths = lengths + now_.level_rows, *fixed_lengths = hard_lengths + now_.rows, longest = 1.0;
        for (int i = 0; i < now_.level_rows; i++) longest = max(longest, lengths[i] = norm(matrix + size_t(i) * stride, stride));
        for (int i = 0; i < now_.rows; i++) {
            const bool finite = io.row_upper[i] < INFINITE;
            longest = max(longest, hard_lengths[i] = finite ? norm(rows + size_t(i) * stride, stride) : 0.0);
        }
        for (int i = 0; i < now_.equalities; i++)
            longest = max(longest, fixed_lengths[i] = norm(fixed + size_t(i) * stride, stride));
        shortest_row_ = (noise_ == tol_.NOISE ? tol_.ROUNDING : noise_) * longest;
        zero_ = arena_.array<int>(now_.level_rows + now_.rows);

        matrix_ = matrix;
        rows_as_given_ = rows;
        exceeded_ = arena_.array<uint8_t>(all_);
        level_of_ = arena_.array<int>(all_);
        std::memset(exceeded_, 0, all_);
        std::fill_n(level_of_, all_, HARD);
        read_hard(rows, hard_lengths, plain);
        read_equalities(fixed, fixed_lengths, plain);
        for (int l = 0, next = hard_; l < now_.levels; l++) {
            read_level(l);
            if (!levels_[l].is_soft) continue;
            read_soft(l, next);
            next += levels_[l].given;
        }
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
        normal_ = arena_.doubles(size_t(now_.rows + soft_) * stride);
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
        equal_as_given_ = arena_.array<const double*>(e);
        equalities_ = 0;
        for (int j = 0; j < m_; j++)
            if (io.lower[j] == io.upper[j]) {
                equal_as_given_[equalities_] = equal_ + size_t(equalities_) * stride;
                equal_[size_t(equalities_) * stride + j] = 1.0;
                equal_side_[equalities_++] = plain ? io.lower[j] : io.lower[j] * io.metric_root[j];
            }
        for (int i = 0; i < now_.equalities; i++) {
            const double size = lengths[i];
            if (size == 0.0) continue;
            if (is_rounding(size)) throw Declined{ROUNDING_ROW};
            add(1.0 / size, fixed + size_t(i) * stride, equal_ + size_t(equalities_) * stride, stride);
            equal_as_given_[equalities_] = fixed + size_t(i) * stride;
            equal_side_[equalities_++] = io.equality_target[i] / size;
        }
    }

    // A level's rows that mean something, damping among them.
    void read_level(int l) {
        Block& block = levels_[l];
        const int first = l ? io.ends[l - 1] : 0, end = io.ends[l], damped = io.damping[l] > 0.0 ? m_ : 0, n = end - first;
        block.first = first;
        block.given = n;
        block.n = 0;
        block.is_soft = io.soft[l];
        block.rank_tolerance = block.is_soft ? 0.0 : rank_tolerance_;
        block.asked = 0.0;
        block.row = arena_.array<const double*>(n + damped);
        block.weight = arena_.doubles(n + damped);
        block.root = arena_.doubles(n + damped);
        block.side = arena_.doubles(n + damped);
        block.length = arena_.doubles(n + damped);
        block.order = arena_.array<int>(n + damped);
        for (int i = first; i < end; i++) {
            const bool little = is_rounding(lengths_[i]);
            if (little && lengths_[i] > 0.0) zero_[io.lists[ZERO]++] = i;
            if (!little && io.weights[i] != 0.0 && !block.is_soft) take(block, i);
        }
        if (damped) {
            double* extra = arena_.zeros(size_t(m_) * stride);
            const double strength = sqrt(io.damping[l]);
            if (is_rounding(strength)) throw Declined{ROUNDING_ROW};
            for (int j = 0; j < m_; j++) {
                extra[size_t(j) * stride + j] = strength;
                block.row[block.n] = extra + size_t(j) * stride;
                block.weight[block.n] = block.root[block.n] = 1.0;
                block.length[block.n] = strength;
                block.side[block.n++] = 0.0;
            }
        }
        block.counting = block.n;
    }

    // One more of a level's rows counts.
    void take(Block& block, int i) {
        block.row[block.n] = matrix_ + size_t(i) * stride;
        block.weight[block.n] = io.weights[i];
        block.root[block.n] = sqrt(io.weights[i]);
        block.length[block.n] = lengths_[i];
        block.side[block.n++] = io.target[i];
    }

    // The rows of a soft level among the inequalities, of unit length, from number `next` on.
    void read_soft(int l, int next) {
        Block& block = levels_[l];
        block.soft_start = next;
        double asked = 0.0;
        for (int i = 0; i < block.given; i++) {
            const int from = block.first + i, to = next + i;
            double* normal = normal_ + size_t(to - 2 * m_) * stride;
            clear(normal, stride);
            side_[to] = INFINITE;
            level_of_[to] = l;
            if (!(io.target[from] < INFINITE)) continue;
            asked += io.weights[from] * io.target[from] * io.target[from];
            if (is_rounding(lengths_[from]) || io.weights[from] == 0.0) continue;
            add(1.0 / lengths_[from], matrix_ + size_t(from) * stride, normal, stride);
            side_[to] = io.target[from] / lengths_[from];
        }
        block.asked = sqrt(asked);
    }

    // An inequality in the metric that is no bound, as it is given, and its length.
    std::pair<const double*, double> as_given(int id) const {
        const int hard = id - 2 * m_;
        if (id < hard_) return {rows_as_given_ + size_t(hard) * stride, lengths_[now_.level_rows + hard]};
        const Block& block = levels_[level_of_[id]];
        const int row = block.first + id - block.soft_start;
        return {matrix_ + size_t(row) * stride, lengths_[row]};
    }

    // The exceeded rows of soft levels are what these ask for; levels from `looked_at_` on ask for nothing.
    void take_rows() {
        for (int l = 0; l < now_.levels; l++) {
            Block& block = levels_[l];
            block.n = l < looked_at_ ? block.counting : 0;
            for (int i = 0; block.is_soft && l < looked_at_ && i < block.given; i++)
                if (exceeded_[block.soft_start + i]) take(block, block.first + i);
        }
    }

    const Tolerances tol_;
    const int m_;
    Sizes now_{};
    Arena arena_;
    std::vector<Block> levels_;

    static constexpr int HARD = -1;  // level of hard rows

    int looked_at_ = 0;  // levels, the others are left for later
    int all_ = 0, hard_ = 0, soft_ = 0, rows_ = 0, equalities_ = 0, frozen_ = 0;
    double noise_ = 0.0, rank_tolerance_ = 0.0, shortest_row_ = 0.0;
    bool has_reference_ = false, is_rounded_ = false;  // is_rounded_: rows are not those given, but divided by a metric's root
    int *zero_ = nullptr, *level_of_ = nullptr;  // level_of_: of every inequality
    uint8_t* exceeded_ = nullptr;                // rows of soft levels that are not kept
    double *matrix_ = nullptr, *lengths_ = nullptr;  // of the levels
    const double* rows_as_given_ = nullptr;          // in the metric
    const double** equal_as_given_ = nullptr;        // those that count, frozen joints first
    double *side_ = nullptr, *normal_ = nullptr, *equal_ = nullptr, *equal_side_ = nullptr, *reference_ = nullptr;

    static size_t arena_size(const Sizes& s) {
        const size_t w = padded(s.joints), damped = s.level_rows + size_t(s.levels) * s.joints;
        return (damped + s.equalities + 4 * w + s.rows + 64) * (w + padded(int(damped))) + 4096;
    }
};

}  // namespace prioritized_ik
