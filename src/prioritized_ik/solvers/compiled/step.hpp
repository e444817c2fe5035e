// One joint step and its certificate; what the words mean stands in hierarchy.py, active_set.py and certificate.py.
//
// Coordinates: u = V x in the joint metric, V a chain of reflectors: first what the equalities decide, then one block of x a
// level, then the rest. A row g of u is the row g V of x. Level l asks for R_l x_l + M_l x_<l = c_l in least squares, in
// orthonormal coordinates of its weighted rows.
//
// What this cannot settle clearly (a rank near its cut, a row that the levels above nearly decide, a set of rows that does
// not come to rest, a certificate without margin) it declines: the Python form answers then.
#pragma once

#include <cstdint>
#include <numeric>

#include "dense.hpp"

namespace prioritized_ik {

// Every number stands in tolerances.py, under the same name. FIELD(name)
#define PRIORITIZED_IK_TOLERANCES(FIELD)                                                                                    \
    FIELD(EPS) FIELD(NOISE) FIELD(DEPENDENT) FIELD(SETTLED_PER_RANK_TOLERANCE) FIELD(PROJECTION) FIELD(CERTIFIED) FIELD(GAP) \
    FIELD(UNDECIDED) FIELD(ROUNDING) FIELD(UNFELT) FIELD(NOTHING) FIELD(LEAST_DEMAND) FIELD(OFF) FIELD(KEPT) FIELD(DRIFT)    \
    FIELD(FREE) FIELD(FLOOR) FIELD(ITERATIONS) FIELD(ACCEPTED_VIOLATION) FIELD(MARGIN) FIELD(WEAKEST) FIELD(NEARLY)          \
    FIELD(CUT_MARGIN) FIELD(EMPTY)

struct Tolerances {
#define FIELD(name) double name;
    PRIORITIZED_IK_TOLERANCES(FIELD)
#undef FIELD
};

// How a call ended; the names are those of `Ending` in library.py.
enum Ending : int {
    CLOSED_FORM,   // no row binds
    SOLVED,        // rows bind
    BINDING,       // the closed form breaks a row, and no more was asked for
    ROUNDING_ROW,  // declined: a row is so short that it may be rounding, or is and cannot be kept
    RANK,          // declined: a level's rank is not clear
    EQUALITIES,    // declined: equalities nearly depend on each other
    NEARLY_DECIDED,  // declined: the levels above nearly decide a row that binds
    NEARLY_TIGHT,  // declined: a row is nearly tight
    UNSETTLED,     // declined: the active rows do not come to rest
    UNPROVEN,      // declined: the certificate does not hold, or without margin
};

struct Declined {
    Ending why;
};

// How much there is of everything, at most or now.
struct Sizes {
    int joints, levels, level_rows, rows, equalities;
};

// What the caller writes and reads; arrays of rows have `stride` doubles a row, zeros beyond the joints.
struct Exchange {
    // in
    std::vector<double> matrix, target, weights, damping;  // of the levels, one after the other
    std::vector<double> lower, upper, row_matrix, row_upper, equality_matrix, equality_target, metric_root, reference;
    std::vector<double> settings;  // rank tolerance, noise
    std::vector<int32_t> ends;     // of the levels' rows
    std::vector<uint8_t> guess;    // upper bounds, lower bounds, rows
    // out
    std::vector<double> dtheta;
    std::vector<double> figures;      // a level: gap, relative gap, stationarity, rounding; then violation, scale, costs
    std::vector<double> multipliers;  // in the order of the list that names them
    // First counts: corrections, faces, proofs, and the lengths of the lists that follow. Numbers of the hard rows that the step was computed from, and of those it ends on; of rows that are rounding, the levels' first;
    // of the rows that hold a level, each after its level's number. Upper bounds come first, then lower bounds, then rows.
    std::vector<int32_t> lists;
};

class Step {
  public:
    enum Question { STEP, CLOSED_FORM_ONLY, FROM_GUESS_ONLY };
    enum Count { CORRECTIONS, FACES, PROOFS, ACTIVE, TIGHT, ZERO, HOLDING, COUNTS };
    enum Figure { LEVEL_GAP, RELATIVE_GAP, STATIONARITY, ROUNDING, FIGURES };

    const int stride, figure_count;
    const Sizes most;
    Exchange io;

    Step(const Sizes& sizes, const Tolerances& tolerances)
        : stride(padded(sizes.joints)), figure_count(FIGURES * (sizes.levels + 1) + 2 + sizes.levels), most(sizes), tol_(tolerances),
          m_(sizes.joints), arena_(arena_size(sizes)) {
        const size_t w = stride, m = sizes.joints, all = 2 * m + sizes.rows;
        io.matrix.resize(sizes.level_rows * w);
        io.target.resize(sizes.level_rows);
        io.weights.resize(sizes.level_rows);
        io.damping.resize(sizes.levels);
        io.lower.resize(m);
        io.upper.resize(m);
        io.row_matrix.resize(sizes.rows * w);
        io.row_upper.resize(sizes.rows);
        io.equality_matrix.resize(sizes.equalities * w);
        io.equality_target.resize(sizes.equalities);
        io.metric_root.resize(m);
        io.reference.resize(m);
        io.settings.resize(2);
        io.ends.resize(sizes.levels);
        io.guess.resize(all);
        io.dtheta.resize(w);
        io.figures.resize(figure_count);
        io.multipliers.resize((sizes.levels + 1) * all);
        io.lists.resize(COUNTS + 2 * all + sizes.level_rows + sizes.rows + 2 * (sizes.levels + 1) * all);
        levels_.resize(sizes.levels + 1);
    }

    int solve(const Sizes& now, Question question) {
        for (;;) {
            try {
                now_ = now;
                return answer(question);
            } catch (const Declined& declined) {
                return declined.why;
            } catch (const Arena::Exhausted&) {
                arena_.enlarge();
            }
        }
    }

  private:
    // One level's rows, and its block of coordinates.
    struct Block {
        int first, given, n;       // its rows as given; those that count
        double** row;              // as given, in the metric (n)
        double *root, *side, *length;  // square roots of their weights, targets, and lengths (n)
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

    static size_t arena_size(const Sizes& s) {
        const size_t w = padded(s.joints), damped = s.level_rows + size_t(s.levels) * s.joints;
        return (damped + s.equalities + 4 * w + s.rows + 64) * (w + padded(int(damped))) * 2 + 4096;
    }

    // ------------------------------------------------------------------------------------------------ the course of a call

    int answer(Question question) {
        arena_.back_to(0);
        std::fill_n(io.lists.begin(), int(COUNTS), 0);
        read();
        factor();
        u_ = arena_.zeros(stride);
        x_ = arena_.zeros(stride);
        reach_ = arena_.doubles(all_);
        slack_ = arena_.doubles(all_);
        active_ = arena_.array<uint8_t>(all_);
        std::memset(active_, 0, all_);
        broken_ = broken_at_start();
        bool guessed = false;
        for (int i = 0; i < all_; i++) guessed = guessed || (io.guess[i] && side_[i] < INFINITE);

        // Rows of the last step come first, as a rule they are right. A step that they hold by a multiplier is not the closed
        // form's; any other may be, and the closed form has the first word then.
        closed_form_ = -1.0;
        if (guessed && question != CLOSED_FORM_ONLY) {
            start_from_guess();
            if (search() && (question == FROM_GUESS_ONLY || io.lists[HOLDING])) return SOLVED;
            std::fill_n(io.lists.begin(), int(ZERO), 0);
            io.lists[HOLDING] = 0;
        }
        face(nullptr, 0);
        closed_form_ = norm(u_, m_);
        if (question != FROM_GUESS_ONLY) {
            measure();
            if (worst_ >= -tol_.FREE * scale_) {
                if (!prove(nullptr, 0)) throw Declined{UNPROVEN};
                conclude(nullptr, 0);
                return CLOSED_FORM;
            }
            if (question == CLOSED_FORM_ONLY) return BINDING;
        }
        std::memset(active_, 0, all_);
        if (!search()) throw Declined{UNSETTLED};
        return SOLVED;
    }

    void start_from_guess() {
        for (int i = 0; i < all_; i++) active_[i] = io.guess[i] && side_[i] < INFINITE;
    }

    // The length of the closed form, worked out when a step is so short that it matters.
    double closed_form_length() {
        if (closed_form_ < 0.0) {
            Scope scope(arena_);
            double *u = arena_.doubles(stride), *x = arena_.doubles(stride);
            const bool doubt = doubt_;
            copy(u_, u, stride);
            copy(x_, x, stride);
            face(nullptr, 0);
            closed_form_ = norm(u_, m_);
            copy(u, u_, stride);
            copy(x, x_, stride);
            doubt_ = doubt;
        }
        return closed_form_;
    }

    // ------------------------------------------------------------------------------------------------------- the problem

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
        const double zero = noise_ * longest;
        auto is_rounding = [&](double size) {
            if (abs(size - zero) <= tol_.CUT_MARGIN * zero) throw Declined{ROUNDING_ROW};
            return size <= zero;
        };

        zero_ = arena_.array<int>(now_.level_rows + now_.rows);

        // Hard rows, of unit length, so that slacks are distances; bounds are in the metric already.
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
            const double size = hard_lengths[i];
            if (size == 0.0) continue;
            if (is_rounding(size)) {
                if (io.row_upper[i] < 0.0) throw Declined{ROUNDING_ROW};
                zero_[io.lists[ZERO]++] = now_.level_rows + i;
                continue;
            }
            add(1.0 / size, from, to, stride);
            side = io.row_upper[i] / size;
        }

        // Equalities, frozen joints first, of unit length.
        const int e = frozen_ + now_.equalities;
        equal_ = arena_.zeros(size_t(e) * stride);
        equal_side_ = arena_.doubles(e);
        equalities_ = 0;
        for (int j = 0; j < m_; j++)
            if (io.lower[j] == io.upper[j]) {
                equal_[size_t(equalities_) * stride + j] = 1.0;
                equal_side_[equalities_++] = plain ? io.lower[j] : io.lower[j] * root[j];
            }
        for (int i = 0; i < now_.equalities; i++) {
            const double size = fixed_lengths[i];
            if (size == 0.0) continue;
            if (is_rounding(size)) throw Declined{ROUNDING_ROW};
            add(1.0 / size, fixed + size_t(i) * stride, equal_ + size_t(equalities_) * stride, stride);
            equal_side_[equalities_++] = io.equality_target[i] / size;
        }

        // Levels: the rows that mean something, damping among them.
        rows_ = equalities_;
        int first = 0;
        for (int l = 0; l < now_.levels; l++) {
            Block& block = levels_[l];
            const int end = io.ends[l], damped = io.damping[l] > 0.0 ? m_ : 0, n = end - first;
            block.first = first;
            block.given = n;
            block.n = 0;
            block.row = arena_.array<double*>(n + damped);
            block.root = arena_.doubles(n + damped);
            block.side = arena_.doubles(n + damped);
            block.length = arena_.doubles(n + damped);
            block.order = arena_.array<int>(n + damped);
            for (int i = first; i < end; i++) {
                const bool little = is_rounding(lengths[i]);
                if (little && lengths[i] > 0.0) zero_[io.lists[ZERO]++] = i;
                if (little || io.weights[i] == 0.0) continue;
                block.row[block.n] = matrix + size_t(i) * stride;
                block.root[block.n] = sqrt(io.weights[i]);
                block.length[block.n] = lengths[i];
                block.side[block.n++] = io.target[i];
            }
            if (damped) {
                double* extra = arena_.zeros(size_t(m_) * stride);
                const double strength = sqrt(io.damping[l]);
                for (int j = 0; j < m_; j++) {
                    extra[size_t(j) * stride + j] = strength;
                    if (is_rounding(strength)) throw Declined{ROUNDING_ROW};
                    block.length[block.n] = strength;
                    block.row[block.n] = extra + size_t(j) * stride;
                    block.root[block.n] = 1.0;
                    block.side[block.n++] = 0.0;
                }
            }
            rows_ += block.n;
            first = end;
        }

        reference_ = arena_.zeros(stride);
        has_reference_ = false;
        for (int j = 0; j < m_; j++) {
            reference_[j] = io.reference[j] * root[j];
            has_reference_ = has_reference_ || reference_[j] != 0.0;
        }
    }

    // ------------------------------------------------------------------------------------------------------- the factors

    void factor() {
        double* work = arena_.doubles(size_t(rows_) * stride);
        double** row = arena_.array<double*>(rows_);
        for (int i = 0; i < rows_; i++) row[i] = work + size_t(i) * stride;
        const int most = 2 * m_ + 1;
        chain_.reset(arena_.doubles(size_t(most) * stride), most, stride);
        place_ = arena_.array<int>(m_);
        for (int j = 0; j < m_; j++) place_[j] = j;
        begin_ = arena_.zeros(stride);

        // Rows of unit length where only rounding is cut, as given where the rank tolerance cuts, as in level_decomposition.
        int at = equalities_;
        for (int l = 0; l < now_.levels; l++) {
            Block& block = levels_[l];
            for (int i = 0; i < block.n; i++, at++) {
                copy(block.row[i], row[at], stride);
                if (rank_tolerance_ == 0.0) {
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
        carried_ = arena_.doubles(size_t(all_) * stride);
        drift_ = arena_.doubles(size_t(all_) * stride);
        is_carried_ = arena_.array<uint8_t>(all_);
        has_drift_ = arena_.array<uint8_t>(all_);
        in_doubt_ = arena_.array<uint8_t>(all_);
        std::memset(is_carried_, 0, all_);
        std::memset(has_drift_, 0, all_);
        std::memset(in_doubt_, 0, all_);
    }

    int factor_equalities(double** row) {
        const int n = equalities_;
        if (!n) return 0;
        int* ids = arena_.array<int>(n);
        for (int i = 0; i < n; i++) {
            ids[i] = i;
            copy(equal_ + size_t(i) * stride, row[i], stride);
        }
        double left;
        // Those that say what others say are kept with them, or else the certificate sees it.
        const int r = row_pivoted_lq(row, ids, n, rows_, 0, m_, stride, chain_, tol_.EMPTY, left, arena_);
        if (!(lower_bound(row, r, 0) > tol_.WEAKEST)) throw Declined{EQUALITIES};
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

    double lower_bound(const Triangle& R) {
        Scope scope(arena_);
        double* inverse = arena_.doubles(size_t(R.size) * R.stride);
        R.invert(inverse);
        return 1.0 / norm(inverse, R.size * R.stride);
    }

    void factor_level(Block& block, double** row, int all, double settled) {
        const int c = block.start, n = block.n;
        double top = 0.0, frobenius = 0.0, left = 0.0;
        for (int i = 0; i < n; i++) {
            const double size = rank_tolerance_ == 0.0 ? 1.0 : block.length[i], square = size * size;
            top = max(top, square);
            frobenius += square;
        }
        top = sqrt(top);
        frobenius = sqrt(frobenius);
        int r = row_pivoted_lq(row, block.order, n, all, c, m_, stride, chain_, tol_.EMPTY * top, left, arena_);
        const int before = r;
        r = cut(block, row, all, r, top, frobenius, settled);
        block.rank = r;
        block.is_cut = r < before && rank_tolerance_ > 0.0;
        // How far rounding may have turned the directions below; `weakest` is a bound from below.
        block.blur = r ? tol_.PROJECTION * tol_.EPS / block.weakest : 0.0;
        block.settled = max(settled, block.blur);
        whiten(block, row, n == r && before == r);
    }

    // Cuts a level's r coordinates to its rank; `weakest` becomes what the weakest one kept measures at least.
    int cut(Block& block, double** row, int all, int r, double top, double frobenius, double settled) {
        const int c = block.start, n = block.n;
        const bool rounding = rank_tolerance_ == 0.0;
        const double limit = rounding ? max(noise_, settled) : max(rank_tolerance_, noise_);
        bool triangle = true;
        while (r > 0) {
            if (triangle) {
                const double bound = lower_bound(row, r, c), least = rounding ? bound : bound / frobenius;
                if (least > (rounding ? tol_.WEAKEST : limit)) {
                    block.weakest = least;
                    return r;
                }
            }
            Scope scope(arena_);
            const int s = padded(n);
            double *columns = arena_.zeros(size_t(r) * s), *x = arena_.doubles(padded(r)), *y = arena_.doubles(padded(r));
            int* order = arena_.array<int>(r);
            for (int i = 0; i < n; i++)
                for (int j = 0; j < r; j++) columns[size_t(j) * s + i] = row[i][c + j];
            column_qr(columns, s, r, r, n, order, false, arena_);
            const Triangle R{columns, s, r};
            const double bound = lower_bound(R), assured = rounding ? bound : bound / frobenius;
            if (assured > (rounding ? tol_.WEAKEST : limit)) {
                block.weakest = assured;
                return r;
            }
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
            r--;
            triangle = false;
        }
        block.weakest = 1.0;
        return 0;
    }

    // W^1/2 A in the level's coordinates becomes Q R; the same Q for what the levels above decide, and for the target.
    void whiten(Block& block, double* const* row, bool square) {
        const int c = block.start, r = block.rank, n = block.n, s = padded(max(n, 1)), k = r + c + 1;
        double* columns = arena_.zeros(size_t(k) * s);
        double* factor = arena_.doubles(n);
        block.demand = 0.0;
        for (int i = 0; i < n; i++) {
            const int id = block.order[i];
            factor[i] = block.root[id] * (rank_tolerance_ == 0.0 ? block.length[id] : 1.0);
            const double side = block.root[id] * block.side[id];
            block.demand += side * side;
        }
        block.demand = sqrt(block.demand);
        block.R = Triangle{columns, s, r};
        block.above = columns + size_t(r) * s;
        block.reflectors = nullptr;
        int* turned = arena_.array<int>(r);
        if (square) {  // every row is reached: a lower triangle, read from its end, is an upper one
            for (int i = 0; i < n; i++) {
                const int back = n - 1 - i;
                for (int j = 0; j <= i; j++) columns[size_t(n - 1 - j) * s + back] = factor[i] * row[i][c + j];
                for (int j = 0; j < c; j++) block.above[size_t(j) * s + back] = factor[i] * row[i][place_[j]];
                block.target()[back] = block.root[block.order[i]] * block.side[block.order[i]];
            }
            for (int j = 0; j < r; j++) turned[j] = r - 1 - j;
            std::reverse(block.order, block.order + n);
        } else {
            for (int i = 0; i < n; i++) {
                for (int j = 0; j < r; j++) columns[size_t(j) * s + i] = factor[i] * row[i][c + j];
                for (int j = 0; j < c; j++) block.above[size_t(j) * s + i] = factor[i] * row[i][place_[j]];
                block.target()[i] = block.root[block.order[i]] * block.side[block.order[i]];
            }
            block.reflectors = arena_.doubles(size_t(r) * s);
            block.taus = arena_.doubles(r);
            column_qr(columns, s, k, r, n, turned, true, arena_, block.reflectors, block.taus);
        }
        for (int j = 0; j < r; j++) place_[c + j] = c + turned[j];
        block.inverse = arena_.doubles(size_t(r) * s);
        block.sizes = arena_.doubles(r);
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

    void split_drift(int i, double* row) {
        double* drift = drift_ + size_t(i) * stride;
        for (int l = 0; l < now_.levels; l++) {
            const int c = levels_[l].end();
            if (c == m_) continue;
            const double moves = norm(row + c, m_ - c);
            if (moves <= levels_[l].settled) {
                if (!has_drift_[i]) clear(drift, stride);
                has_drift_[i] = 1;
                for (int j = c; j < m_; j++) drift[j] += row[j], row[j] = 0.0;
            }
            if (may_be_settled(moves, levels_[l].settled)) in_doubt_[i] = 1;
        }
    }

    // ------------------------------------------------------------------------------------------------------ a face's step

    // x_ and u_ := the strict closed form where the rows `ids` (t) hold. See active_set.face_solution.
    void face(const int* ids, int t) {
        io.lists[FACES]++;
        doubt_ = false;
        Scope scope(arena_);
        double *rows = arena_.doubles(size_t(t) * stride), *sides = arena_.doubles(t);
        bool drifting = false;
        carry(ids, t);
        for (int i = 0; i < t; i++) {
            copy(carried(ids[i]), rows + size_t(i) * stride, stride);
            sides[i] = side_[ids[i]];
            drifting = drifting || has_drift_[ids[i]];
            doubt_ = doubt_ || in_doubt_[ids[i]];
        }
        hold(rows, sides, t);
        if (drifting) {
            double worst = 0.0;
            for (int i = 0; i < t; i++) {
                copy(carried(ids[i]), rows + size_t(i) * stride, stride);
                const double moved = has_drift_[ids[i]] ? dot(drift_ + size_t(ids[i]) * stride, x_, stride) : 0.0;
                sides[i] = side_[ids[i]] - moved;
                worst = max(worst, abs(moved));
            }
            if (worst > tol_.DRIFT * norm(x_, m_)) hold(rows, sides, t);
        }
        out_of(x_, u_);
        for (int j = 0, e = 0; e < frozen_; j++)
            if (io.lower[j] == io.upper[j]) u_[j] = equal_side_[e++];
    }

    void hold(double* rows, double* sides, int t) {
        Scope scope(arena_);
        double* y = arena_.doubles(stride);
        copy(begin_, x_, stride);
        for (int l = 0; l < now_.levels; l++) {
            const Block& block = levels_[l];
            const int c = block.start, r = block.rank;
            copy(block.target(), y, r);
            for (int j = 0; j < c; j++)
                if (x_[j] != 0.0) add(-x_[j], block.above + size_t(j) * block.R.stride, y, r);
            if (t) {
                const int left = left_to_levels_below(rows, sides, t, block.end());
                meet(rows + size_t(left) * stride, sides + left, t - left, c, r, &block, y);
                t = left;
            }
            block.R.solve(y);
            copy(y, x_ + c, r);
        }
        const int c = rest_;
        if (has_reference_) {
            double* wanted = arena_.doubles(stride);
            into(reference_, wanted);
            copy(wanted + c, y, m_ - c);
        } else {
            clear(y, m_ - c);
        }
        if (t) meet(rows, sides, t, c, m_ - c, nullptr, y);
        copy(y, x_ + c, m_ - c);
    }

    // Turns rows (t) so that the first ones are independent in the coordinates from c on, and the others zero there.
    int left_to_levels_below(double* rows, double* sides, int t, int c) {
        const int below = m_ - c;
        if (!below) return 0;
        if (clearly_independent(rows, t, c)) return t;
        Scope scope(arena_);
        const int s = padded(t), k = m_ + 1;
        double* columns = arena_.zeros(size_t(k) * s);
        int* order = arena_.array<int>(below);
        for (int i = 0; i < t; i++) {
            const double* row = rows + size_t(i) * stride;
            for (int j = 0; j < below; j++) columns[size_t(j) * s + i] = row[c + j];
            for (int j = 0; j < c; j++) columns[size_t(below + j) * s + i] = row[j];
            columns[size_t(m_) * s + i] = sides[i];
        }
        column_qr(columns, s, k, below, t, order, true, arena_);
        int left = 0;
        for (; left < min(below, t); left++) {
            const double size = abs(columns[size_t(left) * s + left]);
            if (may_be_settled(size, settled_)) doubt_ = true;
            if (!(size > settled_)) break;
        }
        for (int i = 0; i < t; i++) {
            double* row = rows + size_t(i) * stride;
            for (int j = 0; j < below; j++) row[c + order[j]] = i < left ? columns[size_t(j) * s + i] : 0.0;
            for (int j = 0; j < c; j++) row[j] = columns[size_t(below + j) * s + i];
            sides[i] = columns[size_t(m_) * s + i];
        }
        return left;
    }

    // Whether rows are independent from column c on, by far, seen from their products.
    bool clearly_independent(const double* rows, int t, int c) {
        constexpr double LEAST = 1e-3, SHARE = 1e-8;
        if (t > m_ - c) return false;
        Scope scope(arena_);
        const int s = padded(t);
        double* gram = arena_.doubles(size_t(t) * s);
        for (int i = 0; i < t; i++) {
            double* own = gram + size_t(i) * s;
            for (int j = 0; j <= i; j++)
                own[j] = dot(rows + size_t(i) * stride + c, rows + size_t(j) * stride + c, m_ - c);
            for (int j = 0; j < i; j++) {
                const double* other = gram + size_t(j) * s;
                own[j] = (own[j] - dot(own, other, j)) / other[j];
            }
            const double size = own[i], rest = size - dot(own, own, i);
            if (!(rest > SHARE * max(LEAST, size))) return false;
            own[i] = sqrt(rest);
        }
        return true;
    }

    // y (r), a level's wish in its own coordinates, moves to the nearest that lets rows (t) hold. `block` is null at the rest.
    void meet(const double* rows, const double* sides, int t, int c, int r, const Block* block, double* y) {
        if (!t || !r) return;
        Scope scope(arena_);
        double *normals = arena_.zeros(size_t(t) * stride), *gaps = arena_.doubles(t);
        int n = 0;
        for (int i = 0; i < t; i++) {
            const double* row = rows + size_t(i) * stride;
            if (norm(row + c, m_ - c) <= tol_.DEPENDENT) continue;  // it copies other rows
            double* normal = normals + size_t(n) * stride;
            clear(normal, stride);
            copy(row + c, normal, r);
            if (block) block->R.solve_transposed(normal);
            const double size = norm(normal, r);
            if (size == 0.0) continue;
            for (int j = 0; j < r; j++) normal[j] /= size;
            gaps[n++] = (sides[i] - dot(row, x_, c)) / size;
        }
        if (n) shift(normals, gaps, n, r, y);
    }

    // y := y + the shortest shift with normals (n) y = gaps; twice, as the first leaves the rounding of a large y.
    void shift(const double* normals, const double* gaps, int n, int r, double* y) {
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
            if (abs(row[i][i]) < tol_.WEAKEST) doubt_ = true;
        double* z = arena_.doubles(s);
        for (int again = 0; again < 2; again++) {
            clear(z, s);
            for (int i = 0; i < rank; i++) {
                const double gap = gaps[ids[i]] - dot(normals + size_t(ids[i]) * stride, y, r);
                z[i] = (gap - dot(row[i], z, i)) / row[i][i];
            }
            chain.apply_reversed(z);
            for (int j = 0; j < r; j++) y[j] += z[j];
        }
    }

    // ------------------------------------------------------------------------------------------------------ the active set

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
        for (int i = 0; i < now_.rows; i++) {
            const int k = 2 * m_ + i;
            slack[k] = side_[k] < INFINITE ? side_[k] - dot(normal_ + size_t(i) * stride, u, stride) : INFINITE;
        }
    }

    // Slacks at u_, the worst of them, and what figures of u_ are relative to, see Hierarchy.scale.
    void measure() {
        slacks(u_, reach_);
        worst_ = INFINITE;
        for (int i = 0; i < all_; i++) worst_ = min(worst_, reach_[i]);
        size_ = norm(u_, m_);
        scale_ = size_;
        if (size_ > tol_.FLOOR * max(closed_form_ < 0.0 ? longest_ : closed_form_, broken_) && size_ > 0.0) return;
        const double likely = max(closed_form_length(), broken_);
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

    int listed(int* ids) const {
        int t = 0;
        for (int i = 0; i < all_; i++)
            if (active_[i]) ids[t++] = i;
        return t;
    }

    uint64_t digest() const {
        uint64_t hash = 1469598103934665603ull;
        for (int i = 0; i < all_; i++) hash = (hash ^ active_[i]) * 1099511628211ull;
        return hash;
    }
    bool is_visited() const { return std::find(visited_.begin(), visited_.end(), digest()) != visited_.end(); }

    // From the active rows to the optimum; false if that leads nowhere. No set is visited twice: where the rule would return
    // to one, the next best row is dropped instead.
    bool search() {
        Scope scope(arena_);
        int* ids = arena_.array<int>(all_);
        uint8_t* proven = arena_.array<uint8_t>(all_);  // the active rows at the last proof, and the slacks there
        double* proven_slack = arena_.doubles(all_);
        size_t next = 0;
        visited_.clear();
        wrong_.clear();
        slacks(start_, slack_);
        auto dropped = [&] {
            for (; next < wrong_.size(); next++) {
                std::memcpy(active_, proven, all_);
                active_[wrong_[next]] = 0;
                if (!is_visited()) {
                    copy(proven_slack, slack_, all_);
                    return true;
                }
            }
            return false;
        };
        for (int iteration = 0; iteration < int(tol_.ITERATIONS); iteration++) {
            visited_.push_back(digest());
            face(ids, listed(ids));
            measure();
            if (!(size_ < INFINITE)) return false;
            io.lists[CORRECTIONS] = iteration;
            if (advance()) {
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
                if (!same) settle(ids);
                else conclude(ids, t);
                return true;
            }
            std::memcpy(proven, active_, all_);
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
            if (!active_[i] && reach_[i] < -kept) {
                const double rate = slack_[i] - reach_[i];
                first = min(first, rate > 0.0 ? max(slack_[i], 0.0) / rate : 0.0);
            }
        if (first == INFINITE) {
            copy(reach_, slack_, all_);
            return false;
        }
        for (int i = 0; i < all_; i++) {
            if (!active_[i] && reach_[i] < -kept) {
                const double rate = slack_[i] - reach_[i];
                if ((rate > 0.0 ? max(slack_[i], 0.0) / rate : 0.0) <= first) active_[i] = 1;
            }
            if (side_[i] < INFINITE) slack_[i] += first * (reach_[i] - slack_[i]);
        }
        return true;
    }

    bool is_near(int i) const { return reach_[i] <= tol_.CERTIFIED * scale_; }

    // The step of exactly the rows that it ends on, so that all guesses that lead there lead to the same bits; proven anew.
    void settle(int* ids) {
        constexpr int TRIES = 3;
        for (int again = 0; again < TRIES; again++) {
            for (int i = 0; i < all_; i++) active_[i] = is_near(i);
            const int t = listed(ids);
            face(ids, t);
            measure();
            bool same = true;
            for (int i = 0; i < all_; i++) same = same && active_[i] == is_near(i);
            if (!same) continue;
            if (!prove(ids, t)) throw Declined{UNPROVEN};
            conclude(ids, t);
            return;
        }
        throw Declined{UNSETTLED};
    }

    // -------------------------------------------------------------------------------------------------------- the certificate

    // Whether u_ is proven optimal from the rows `ids` (t) that it ends on. If not, `wrong_` are the active rows that
    // pull, most first. See certificate.py; rounding explains nothing away here, so that what holds here holds there.
    bool prove(const int* ids, int t) {
        io.lists[PROOFS]++;
        Scope scope(arena_);
        carry(ids, t);
        Multipliers own(*this, ids, t);
        wrong_.clear();
        blur_ = off_ = above_ = 0.0;
        for (int l = 0; l < now_.levels; l++)
            if (!prove_level(own, l)) return false;
        return prove_level(own, now_.levels);
    }

    // What all levels of one proof share.
    struct Multipliers {
        int t;
        const int* ids;
        const double** row;  // the rows in x
        double* leak;        // how far a row can move that a level above holds; infinite for the others
        double* values;      // by level (t)
        Multipliers(Step& step, const int* ids_, int t_) : t(t_), ids(ids_) {
            Arena& arena = step.arena_;
            row = arena.array<const double*>(t);
            leak = arena.doubles(t);
            step.multipliers_ = values = step.proof_memory(t);
            for (int i = 0; i < t; i++) {
                row[i] = step.carried(ids[i]);
                leak[i] = INFINITE;
            }
        }
    };

    double* proof_memory(int t) {
        const size_t size = size_t(now_.levels + 1) * max(t, 1);
        if (proof_.size() < size) proof_.resize(size);
        std::fill(proof_.begin(), proof_.begin() + size, 0.0);
        return proof_.data();
    }

    // The gradient of a level in its own coordinates, from its rows as they are given, and what it is made of.
    struct Gradient {
        double* values;
        double terms, cost, steepness, strength, size;
    };

    // The step without what it does along directions that a level hardly feels and that were cut from it.
    const double* without_below(const Block& block) {
        double *x = arena_.doubles(stride), *u = arena_.doubles(stride);
        into(u_, x);
        clear(x + block.end(), stride - block.end());
        out_of(x, u);
        return u;
    }

    Gradient gradient_of(const Block& block) {
        const int n = block.n, s = padded(max(n, 1));
        Gradient g{arena_.zeros(max(s, stride)), 0.0, 0.0, 0.0, 0.0, 0.0};
        double *residual = arena_.zeros(s), *slope = arena_.zeros(stride);
        const double* u = block.is_cut ? without_below(block) : u_;
        for (int i = 0; i < n; i++) {
            const int id = block.order[i];
            const double *row = block.row[id], root = block.root[id], value = root * (dot(row, u, stride) - block.side[id]);
            residual[i] = value;
            g.cost += value * value;
            g.strength += root * root * block.length[id] * block.length[id];
            add(root * value, row, slope, stride);
        }
        g.strength = sqrt(g.strength);
        g.steepness = 2.0 * norm(slope, m_);
        g.size = block.demand + block.strength * size_;
        g.terms = g.size;  // what the change of coordinates leaves of a step that a level does not feel is rounding too
        if (block.reflectors)
            for (int j = 0; j < block.rank; j++) {
                const int from = aligned_start(j);
                reflect(residual + from, block.reflectors + size_t(j) * s + from, block.taus[j], s - from);
            }
        copy(residual, g.values, block.rank);
        return g;
    }

    Gradient last_gradient() {
        Gradient g{arena_.zeros(stride), 0.0, 0.0, 0.0, 0.0, 0.0};
        double *apart = arena_.zeros(stride), *turned = arena_.doubles(stride);
        for (int j = 0; j < m_; j++) apart[j] = u_[j] - reference_[j];
        into(apart, turned);
        copy(turned + rest_, g.values, m_ - rest_);
        g.size = size_ + norm(reference_, m_);
        g.terms = g.size;
        g.cost = dot(apart, apart, m_);
        g.steepness = 2.0 * sqrt(g.cost);
        g.strength = sqrt(double(m_));
        return g;
    }

    bool prove_level(Multipliers& own, int l) {
        constexpr int IMPROVEMENTS = 2;
        Scope scope(arena_);
        const bool last = l == now_.levels;
        const Block* block = last ? nullptr : &levels_[l];
        const int c = last ? rest_ : block->start, r = last ? m_ - rest_ : block->rank, below = m_ - c - r, v = r + below;
        const Gradient g = last ? last_gradient() : gradient_of(*block);
        const double far = last ? 1.0 : block->shortest / tol_.UNFELT;

        // Rows that move in what is left, those held by a level above first.
        double* normals = arena_.zeros(size_t(own.t + 1) * stride);
        double *sizes = arena_.doubles(own.t), *combination = arena_.doubles(own.t);
        int *place = arena_.array<int>(own.t), n = 0, held = 0;
        const double steep = norm(g.values, r);
        if (steep > tol_.ROUNDING * g.terms) {
            for (int pass = 0; pass < 2; pass++)
                for (int i = 0; i < own.t; i++) {
                    const double *row = own.row[i], moves = norm(row + c, v);
                    if ((own.leak[i] < INFINITE) != (pass == 0)) continue;
                    if (may_be_settled(moves, settled_)) doubt_ = true;
                    if (!(moves > settled_)) continue;
                    double* normal = normals + size_t(n) * stride;
                    copy(row + c, normal, v);
                    if (block) {
                        Scope inner(arena_);
                        block->R.solve_transposed(normal);
                        for (int j = r; j < v; j++) normal[j] *= far;
                    }
                    sizes[n] = norm(normal, v);
                    for (int j = 0; j < v; j++) normal[j] /= sizes[n];
                    place[n++] = i;
                    held += pass == 0;
                }
            if (!balance(normals, n, held, v, g.values, combination)) return pulls(own, normals, place, n, held, v, g);
        }

        // What is left of the gradient; where that is not nothing yet, the combination is improved by what is left.
        const Span span{block, c, r, below, far};
        double* rest = arena_.zeros(stride);
        balance_left(span, own, place, n, combination, sizes, g.values, rest);
        double excess = as_step(span, rest);
        for (int again = 0; again < IMPROVEMENTS && n && excess > tol_.MARGIN * tol_.CERTIFIED * scale_; again++) {
            if (!improve(normals, n, held, v, rest, combination)) break;
            balance_left(span, own, place, n, combination, sizes, g.values, rest);
            excess = as_step(span, rest);
        }
        const double unfelt = norm(rest + r, below);

        // How much of the rest rounding can feign, and how far that reaches as a step.
        double *rough = arena_.zeros(padded(v)), *beyond = arena_.doubles(padded(v)), sum = 0.0, net = 0.0, explained = 0.0;
        for (int j = 0; j < r; j++) rough[j] = tol_.ROUNDING * g.terms;
        for (int i = 0; i < n; i++) {
            const double *normal = normals + size_t(i) * stride, share = tol_.ROUNDING * abs(combination[i]);
            for (int j = 0; j < v; j++) rough[j] += share * abs(normal[j]);
            sum += abs(combination[i]);
            net += abs(combination[i]) / sizes[i];
        }
        for (int j = 0; j < v; j++) {
            const double size = j >= r ? far : block ? block->sizes[j] : 1.0;
            rough[j] += blur_ * net * size;
            beyond[j] = max(abs(rest[j]) - rough[j], 0.0);
            explained += size * size * rough[j] * rough[j];
        }
        // Strong rows, far from what they ask for, leave rounding in a level's weak directions.
        const double follows = block ? g.strength * block->inverse_norm : 0.0;
        const double leaks = block ? tol_.EPS * follows * sqrt(g.cost) * block->longest : 0.0;
        explained = max(sqrt(explained), leaks);

        // Weak duality.
        double gap = dot(beyond, beyond, v) + dot(rough, rough, v) + 2.0 * norm(beyond + r, below) / far * scale_, apart = 0.0;
        double* values = own.values + size_t(l) * own.t;
        for (int i = 0; i < n; i++) {
            const int k = place[i];
            const double pull = combination[i] / sizes[i], slack = abs(reach_[own.ids[k]]);
            const bool counts = abs(combination[i]) > tol_.NOTHING * (g.terms + sum), back = i < held && pull < 0.0;
            gap += 2.0 * abs(pull) * (back ? own.leak[k] : slack);
            if (!counts) continue;
            values[k] = pull;
            if (!last && !back) {
                const int from = below && norm(own.row[k] + c + r, below) > settled_ ? c + r : c;
                apart += slack / norm(own.row[k] + from, m_ - from);
                if (slack > tol_.ROUNDING * scale_ / tol_.MARGIN) apart = INFINITE;
            }
        }
        for (int i = held; i < n; i++)
            if (values[place[i]] > 0.0) own.leak[place[i]] = gap / values[place[i]];

        const double drawn = off_ * (1.0 + follows), carried_over = max(above_, drawn);
        above_ = max(above_, max(explained, apart));
        off_ = drawn + (excess > tol_.OFF * scale_ ? excess : 0.0);
        const double demand = max(last ? g.size : block->demand, max(sqrt(g.cost), tol_.LEAST_DEMAND * g.size));
        double* figures = io.figures.data() + size_t(l) * FIGURES;
        const double moved = g.strength * carried_over;
        figures[LEVEL_GAP] = gap + g.steepness * carried_over + moved * moved;
        if (!last) blur_ = max(blur_, block->blur);
        figures[RELATIVE_GAP] = gap > 0.0 && demand > 0.0 ? gap / (demand * demand) : 0.0;
        figures[STATIONARITY] = excess / scale_;
        figures[ROUNDING] = max(explained, max(apart, off_)) / scale_;
        const double allowed = last ? tol_.UNDECIDED : tol_.GAP;  // as in Certificate.holds
        if (excess <= tol_.CERTIFIED * scale_ && figures[RELATIVE_GAP] <= allowed) return true;
        return pulls(own, normals, place, n, held, v, g);
    }

    // Where a level's proof stands: its block, or null, and its coordinates, with those below.
    struct Span {
        const Block* block;
        int start, rank, below;
        double far;
    };

    // rest := the gradient with the combination of rows added. The rows are summed before the level's coordinates are
    // changed, as each by itself would leave more rounding than rows that nearly cancel leave of each other.
    void balance_left(const Span& at, const Multipliers& own, const int* place, int n, const double* combination,
                      const double* sizes, const double* gradient, double* rest) {
        clear(rest, stride);
        for (int i = 0; i < n; i++)
            if (combination[i] != 0.0) add(combination[i] / sizes[i], own.row[place[i]] + at.start, rest, at.rank + at.below);
        if (at.block) {
            at.block->R.solve_transposed(rest);
            for (int j = at.rank; j < at.rank + at.below; j++) rest[j] *= at.far;
        }
        for (int j = 0; j < at.rank; j++) rest[j] += gradient[j];
    }

    // How long a step is that a gradient in a level's coordinates asks for.
    double as_step(const Span& at, const double* rest) {
        Scope scope(arena_);
        double* step = arena_.zeros(stride);
        copy(rest, step, at.rank);
        if (at.block) at.block->R.solve(step);
        const double unfelt = at.far * norm(rest + at.rank, at.below);
        return sqrt(dot(step, step, at.rank) + unfelt * unfelt);
    }

    // Adds to a combination what balances the rest in least squares; false, and no change, if a sign would be wrong.
    bool improve(const double* normals, int n, int held, int v, const double* rest, double* combination) {
        Scope scope(arena_);
        double* columns = arena_.doubles(size_t(n + 1) * stride);
        int *ids = arena_.array<int>(n), *order = arena_.array<int>(n), k = 0;
        for (int i = 0; i < n; i++)
            if (combination[i] != 0.0) {
                copy(normals + size_t(i) * stride, columns + size_t(k) * stride, stride);
                ids[k++] = i;
            }
        double* side = columns + size_t(k) * stride;
        clear(side, stride);
        for (int j = 0; j < v; j++) side[j] = -rest[j];
        column_qr(columns, stride, k + 1, k, v, order, true, arena_);
        int rank = min(k, v);
        while (rank > 0 && abs(columns[size_t(rank - 1) * stride + rank - 1]) <= tol_.DEPENDENT) rank--;
        Triangle{columns, stride, rank}.solve(side);
        for (int j = 0; j < rank; j++)
            if (const int i = ids[order[j]]; i >= held && combination[i] + side[j] < 0.0) return false;
        for (int j = 0; j < rank; j++) combination[ids[order[j]]] += side[j];
        return rank > 0;
    }

    // The combination of normals (n), of either sign for the first `held`, that balances the gradient best.
    bool balance(const double* normals, int n, int held, int v, const double* gradient, double* combination) {
        for (int i = 0; i < n; i++) combination[i] = 0.0;
        if (!n) return true;
        Scope scope(arena_);
        double* side = arena_.zeros(stride);
        for (int j = 0; j < v; j++) side[j] = -gradient[j];
        if (!held) return nonnegative_least_squares(normals, stride, n, v, side, combination, arena_);
        double* columns = arena_.doubles(size_t(n + 1) * stride);
        int* order = arena_.array<int>(held);
        copy(normals, columns, size_t(n) * stride);
        double* turned = columns + size_t(n) * stride;
        copy(side, turned, stride);
        column_qr(columns, stride, n + 1, held, v, order, true, arena_);
        int rank = min(held, v);
        while (rank > 0 && abs(columns[size_t(rank - 1) * stride + rank - 1]) <= tol_.DEPENDENT) rank--;
        if (n > held && rank < v) {
            const int others = n - held, left = v - rank, s = padded(left);
            double *shorter = arena_.zeros(size_t(others) * s), *target = arena_.zeros(s);
            for (int i = 0; i < others; i++) copy(columns + size_t(held + i) * stride + rank, shorter + size_t(i) * s, left);
            copy(turned + rank, target, left);
            if (!nonnegative_least_squares(shorter, s, others, left, target, combination + held, arena_)) return false;
        }
        double* z = arena_.zeros(stride);
        copy(turned, z, rank);
        for (int i = held; i < n; i++)
            if (combination[i] != 0.0) add(-combination[i], columns + size_t(i) * stride, z, rank);
        Triangle{columns, stride, rank}.solve(z);
        for (int j = 0; j < rank; j++) combination[order[j]] = z[j];
        return true;
    }

    // Finds the active rows whose multipliers are negative if all active ones are taken as equalities; always false.
    bool pulls(const Multipliers& own, const double* normals, const int* place, int n, int held, int v, const Gradient& g) {
        Scope scope(arena_);
        double* columns = arena_.zeros(size_t(n + 1) * stride);
        int *rows = arena_.array<int>(n), *order = arena_.array<int>(n), *places = arena_.array<int>(n), k = 0;
        for (int i = 0; i < n; i++)
            if (active_[own.ids[place[i]]]) {
                copy(normals + size_t(i) * stride, columns + size_t(k) * stride, v);
                rows[k++] = i;
            }
        double* side = columns + size_t(k) * stride;
        for (int j = 0; j < v; j++) side[j] = -g.values[j];
        column_qr(columns, stride, k + 1, k, v, order, true, arena_);
        int rank = min(k, v);
        while (rank > 0 && abs(columns[size_t(rank - 1) * stride + rank - 1]) <= tol_.DEPENDENT) rank--;
        Triangle{columns, stride, rank}.solve(side);
        std::iota(places, places + rank, 0);
        std::sort(places, places + rank, [&](int i, int j) { return side[i] < side[j]; });
        for (const bool is_held : {false, true})  // those held by a level above may have either sign, if they are held
            for (int j = 0; j < rank; j++) {
                const int row = rows[order[places[j]]];
                if ((row < held) == is_held && side[places[j]] < 0.0) wrong_.push_back(own.ids[place[row]]);
            }
        return false;
    }

    // Writes the proven step, if its certificate has margin.
    void conclude(const int* ids, int t) {
        const int levels = now_.levels;
        const double margin = tol_.MARGIN, near = tol_.CERTIFIED * scale_;
        double violation = max(0.0, -worst_), variation = 0.0;
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
        for (int i = 0; i < all_ && t; i++)
            if (reach_[i] > margin * near && reach_[i] < near / margin) throw Declined{NEARLY_TIGHT};
        figures[0] = violation / scale_;
        figures[1] = scale_;

        for (int j = 0; j < m_; j++) io.dtheta[j] = u_[j] / io.metric_root[j];
        int32_t *counts = io.lists.data(), *list = counts + COUNTS;
        for (int i = 0; i < t; i++) *list++ = ids[i];
        counts[ACTIVE] = t;
        for (int i = 0; i < all_; i++) {
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
        for (int l = 0; l < levels; l++) {
            const Block& block = levels_[l];
            double cost = 0.0;
            for (int i = block.first; i < block.first + block.given; i++) {
                const double off = dot(io.matrix.data() + size_t(i) * stride, io.dtheta.data(), stride) - io.target[i];
                cost += io.weights[i] * off * off;
            }
            figures[2 + l] = cost;
        }
    }

    const Tolerances tol_;
    const int m_;
    Sizes now_{};
    Arena arena_;
    std::vector<Block> levels_;
    Reflectors chain_, small_chain_;
    std::vector<uint64_t> visited_;
    std::vector<double> proof_;

    // the problem in its metric
    int all_ = 0, rows_ = 0, equalities_ = 0, frozen_ = 0;
    double noise_ = 0.0, rank_tolerance_ = 0.0;
    bool has_reference_ = false;
    int* zero_ = nullptr;
    double *side_ = nullptr, *normal_ = nullptr, *equal_ = nullptr, *equal_side_ = nullptr, *reference_ = nullptr;

    // the factors
    int rest_ = 0, *place_ = nullptr;
    double lowest_ = 0.0, settled_ = 0.0, turned_ = 0.0, *begin_ = nullptr, *carried_ = nullptr, *drift_ = nullptr;
    uint8_t *is_carried_ = nullptr, *has_drift_ = nullptr, *in_doubt_ = nullptr;

    // the step
    double *u_ = nullptr, *x_ = nullptr, *reach_ = nullptr, *slack_ = nullptr, *start_ = nullptr, *multipliers_ = nullptr;
    uint8_t* active_ = nullptr;
    double closed_form_ = 0.0, longest_ = 0.0, broken_ = 0.0, worst_ = 0.0, size_ = 0.0, scale_ = 0.0;
    double blur_ = 0.0, off_ = 0.0, above_ = 0.0;
    bool doubt_ = false;
    std::vector<int> wrong_;  // active rows to drop in turn
};

}  // namespace prioritized_ik
