// The fifth layer: the proof that a step is optimal at every level; see certificate.py.
#pragma once

#include <numeric>

#include "extended.hpp"
#include "nonnegative.hpp"

namespace prioritized_ik {

class Certified : public Extended {
  protected:
    using Extended::Extended;

    // Whether u_ is proven optimal from the rows `ids` (t) that it ends on. If not, `wrong_` are the active rows that
    // pull, most first. See certificate.py; rounding explains nothing away here, so that what holds here holds there.
    // `closely`: looks closer wherever rows have multipliers.
    bool prove(const int* ids, int t, bool closely = false) {
        closely_ = closely;
        io.lists[PROOFS]++;
        Scope scope(arena_);
        start_looks();
        mends_ = false;
        closest_ = 0.0;
        carry(ids, t);
        Multipliers own(*this, ids, t);
        wrong_.clear();
        off_ = above_ = handed_ = 0.0;
        given_ = equalities_ ? 0.5 * tol_.EPS / equalities_weakest_ : 0.0;
        blur_as_given_ = equalities_ ? tol_.PROJECTION * tol_.EPS / equalities_weakest_ : 0.0;
        blur_ = max(blur_as_given_, is_rounded_ ? finest() : 0.0);
        for (int l = 0; l <= now_.levels; l++) {
            while (own.known < t && level_of_[ids[own.known]] < l) own.known++;
            if (l < looked_at_ && levels_[l].is_soft && !counts_what_is_exceeded(levels_[l])) throw Declined{UNSETTLED};
            if (!prove_level(own, l)) return false;
        }
        return true;
    }

    // Whether the rows that a soft level was factored with are those that u_ exceeds.
    bool counts_what_is_exceeded(const Block& block) const {
        int n = 0;
        for (int i = 0; i < block.given; i++) {
            if (!(reach_[block.soft_start + i] < -tol_.CERTIFIED * scale_)) continue;
            if (n == block.n || block.row[n++] != matrix_ + size_t(block.first + i) * stride) return false;
        }
        return n == block.n;
    }

    // What all levels of one proof share.
    struct Multipliers {
        int t, known = 0;    // known: of them, those that may hold the level at hand, hard ones and of soft levels above
        const int* ids;
        const double** row;  // the rows in x
        double* leak;        // how far a row can move that a level above holds; infinite for the others
        double* values;      // by level (t)
        Multipliers(Certified& step, const int* ids_, int t_) : t(t_), ids(ids_) {
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
        g.size = block.strength * scale_;
        // A weak direction is a difference of strong rows: what they leave of each other is rounding of them, not of it.
        g.terms = block.demand + max(g.strength, block.strength) * size_;
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
        g.terms = size_ + norm(reference_, m_);
        g.size = scale_;
        g.cost = dot(apart, apart, m_);
        g.steepness = 2.0 * sqrt(g.cost);
        g.strength = sqrt(double(m_));
        return g;
    }

    // How far rows balance a level's gradient, in coordinates in which its cost is |.|^2: its own, and those below, `far`.
    struct Look {
        int n = 0, held = 0;          // rows that move in what is left; those held by a level above come first
        int* place;                   // their numbers among `own`
        double *normals, *sizes;      // by rows, of unit length; their lengths before
        double* combination;
        double *gradient, *rest;      // the level's, and what is left of it
        double *rough, *beyond;       // what rounding can feign of the rest, and the rest beyond that
        bool is_of_all = false;         // whether the combination is that of all rows taken as equalities, none held
        double far, excess, explained;  // excess: how long a step the rest asks for; explained: what rounding can feign of it
    };

    // Where a level's proof stands: its block, or null, and its coordinates, with those below.
    struct Span {
        const Block* block;
        int start, rank, below;
        int all() const { return rank + below; }
    };

    bool prove_level(Multipliers& own, int l) {
        Scope scope(arena_);
        const bool last = l == now_.levels;
        const Block* block = last ? nullptr : &levels_[l];
        const int c = last ? rest_ : block->start, r = last ? m_ - rest_ : block->rank;
        const Span at{block, c, r, m_ - c - r};
        const int below = at.below, v = at.all();
        const Gradient g = last ? last_gradient() : gradient_of(*block);
        Look look;
        if (!look_at(own, at, g, look)) return pulls(own, at, look);
        // What rounding of doubles can feign is looked at with more digits; what it cannot is there.
        const double fine = tol_.MARGIN * tol_.CERTIFIED * scale_, sure = tol_.MARGIN * tol_.UNDECIDED * scale_;
        const bool is_unclear = look.excess > fine || look.explained > sure || falls(at, g, look);
        if ((closely_ && look.n) || (is_unclear && look.excess <= feigned(look))) look_closer(own, at, l, g, look);
        const double *beyond = look.beyond, *rough = look.rough, excess = look.excess, explained = look.explained;
        const double follows = block ? g.strength * block->inverse_norm : 0.0;
        double sum = 0.0;
        for (int i = 0; i < look.n; i++) sum += abs(look.combination[i]);

        // Weak duality.
        const double room = dot(beyond, beyond, v) + 2.0 * norm(beyond + r, below) / look.far * scale_;
        const bool is_rounding = excess <= tol_.OFF * scale_;
        double gap = is_rounding ? 0.0 : room, apart = 0.0, touching = is_rounding ? room : 0.0;
        bool carries = false;
        const double rounded = dot(rough, rough, v);
        double* values = own.values + size_t(l) * own.t;
        const Doubtful doubtful = doubtful_at(at, look);
        // Rows that hold it by no more than half a unit in the last place of what is given.
        if (max(doubtful.felt, below ? doubtful.unfelt : 0.0) > norm(g.values, r)) doubt_ = true;
        for (int i = 0; i < look.n; i++) {
            const int k = look.place[i];
            const double share = look.combination[i], pull = share / look.sizes[i], slack = abs(reach_[own.ids[k]]);
            const bool is_more = abs(share) > tol_.NOTHING * (g.terms + sum + g.size);
            const bool counts = is_more && doubtful.is_passed(abs(share), look.normals + size_t(i) * stride);
            const bool back = i < look.held && pull < 0.0;
            touching += 2.0 * abs(pull) * rounding_of_slacks();
            // Nearer than the rounding of the step itself it is on the row.
            if (back || slack > tol_.ROUNDING * scale_) gap += 2.0 * abs(pull) * (back ? own.leak[k] : slack);
            else touching += 2.0 * abs(pull) * slack;
            if (!counts) continue;
            values[k] = pull;
            if (!back) {
                carries = true;
                const int from = below && norm(own.row[k] + c + r, below) > settled_ ? c + r : c;
                apart += (slack + handed_) / norm(own.row[k] + from, m_ - from);
                if (slack > tol_.ROUNDING * scale_ / tol_.MARGIN) apart = INFINITE;
            }
        }
        if (carries && falls(at, g, look)) apart = max(apart, scale_);
        for (int i = look.held; i < look.n; i++)
            if (values[look.place[i]] > 0.0) own.leak[look.place[i]] = (gap + rounded) / values[look.place[i]];

        const double drawn = off_ * (1.0 + follows), carried_over = max(max(above_ * (1.0 + follows), drawn), handed_);
        above_ = max(carried_over, max(explained, apart));
        off_ = drawn + (excess > tol_.OFF * scale_ ? excess : 0.0);
        handed_ += excess;
        const double demand = max(last ? g.terms : max(block->demand, block->asked), max(sqrt(g.cost), tol_.LEAST_DEMAND * g.size));
        double* figures = io.figures + size_t(l) * FIGURES;
        const double moved = g.strength * carried_over;
        double steepness = g.steepness;  // rows follow what levels above move, too
        for (int i = 0; i < look.n; i++) steepness += 2.0 * abs(look.combination[i]) / look.sizes[i];
        // Where rows that hold meet at a sharp angle, the rounding of their slacks moves the step by far more.
        const double turned = sharpness_ * rounding_of_slacks(), lost = g.strength * turned;
        figures[LEVEL_GAP] = gap + rounded + touching + steepness * (carried_over + turned) + moved * moved + lost * lost;
        if (!last) {
            given_ = max(given_, given(block));
            blur_ = max(blur_, block->blur);
            // What was cut is none, by decree, for the levels below.
            blur_as_given_ = max(blur_as_given_, block->is_cut ? tol_.PROJECTION * tol_.EPS : block->blur);
        }
        figures[RELATIVE_GAP] = gap > 0.0 && demand > 0.0 ? gap / (demand * demand) : 0.0;
        figures[STATIONARITY] = excess / scale_;
        figures[ROUNDING] = max(explained, max(apart, off_)) / scale_;
        const double allowed = last ? tol_.UNDECIDED * tol_.UNDECIDED : tol_.GAP;  // as in Certificate.holds
        if (mends_) return pulls(own, at, look);
        if (excess <= tol_.CERTIFIED * scale_ && figures[RELATIVE_GAP] <= allowed) return true;
        return pulls(own, at, look);
    }

    // How large a multiplier half a unit in the last place of what is given can make.
    struct Doubtful {
        const Span at;
        const double* sizes;  // of what the level feels, or null for ones
        double felt, unfelt, most;  // how far coordinates can be off, a unit of their length; in any coordinate
        bool is_passed(double share, const double* normal) const {
            if (share > most) return true;
            double allowed = 0.0;
            for (int j = 0; j < at.rank; j++) allowed += abs(normal[j]) * (sizes ? felt * sizes[j] : felt);
            for (int j = at.rank; j < at.all(); j++) allowed += abs(normal[j]) * unfelt;
            return share > allowed;
        }
    };

    // How far half a unit in the last place of a level's rows turns what it leaves.
    double given(const Block* block) const {
        return block && block->rank && !block->is_soft ? 0.5 * tol_.EPS / block->weakest : 0.0;
    }

    Doubtful doubtful_at(const Span& at, const Look& look) const {
        double pulled = 0.0, longest = 1.0;
        for (int i = 0; i < look.n; i++) pulled += abs(look.combination[i]) / look.sizes[i];
        const Block* block = at.block;
        const double own = max(given_, given(block));
        if (block) longest = max(block->longest, look.far);
        const double felt = given_ * pulled, unfelt = own * pulled * look.far;
        return {at, block ? block->sizes : nullptr, felt, unfelt, sqrt(double(at.all())) * own * pulled * longest};
    }

    // Whether a level's cost falls along what it does not feel, until a row is in the way; see Look.falls.
    bool falls(const Span& at, const Gradient& g, const Look& look) const {
        const double rest = norm(look.beyond + at.rank, at.below);
        if (!at.below || !look.n || rest == 0.0) return false;
        double share = 0.0, size = sqrt(double(at.rank));
        for (int i = 0; i < look.n; i++) {
            const double *normal = look.normals + size_t(i) * stride, seen = norm(normal, at.rank);
            if (look.combination[i] != 0.0 && seen > 0.0) share = max(share, norm(normal + at.rank, at.below) / seen);
        }
        const double of_given = sqrt(double(at.below)) * doubtful_at(at, look).unfelt;
        return rest > size * tol_.ROUNDING * g.terms * share + of_given;
    }

    // In doubles; false if rows cannot balance the gradient, which shows early.
    bool look_at(const Multipliers& own, const Span& at, const Gradient& g, Look& look) {
        constexpr int IMPROVEMENTS = 2;
        const Block* block = at.block;
        const int c = at.start, r = at.rank, v = at.all();
        const double far = look.far = block ? block->shortest / tol_.UNFELT : 1.0;
        // Strong rows, far from what they ask for, leave rounding in a level's weak directions.
        const double leak = block ? tol_.EPS * g.strength * block->inverse_norm * sqrt(g.cost) : 0.0;
        look.gradient = g.values;

        // Rows that move in what is left, those held by a level above first.
        double* normals = look.normals = arena_.zeros(size_t(own.t + 1) * stride);
        double *sizes = look.sizes = arena_.doubles(own.t), *combination = look.combination = arena_.doubles(own.t);
        look.place = arena_.array<int>(own.t);
        const double steep = norm(g.values, r);
        if (steep > tol_.ROUNDING * g.terms) {
            gather(own, at, look);
            const int n = look.n;
            for (int i = 0; i < n; i++) copy(own.row[look.place[i]] + c, normals + size_t(i) * stride, v);
            if (block) block->R.solve_transposed(normals, stride, n);
            for (int i = 0; i < n; i++) {
                double* normal = normals + size_t(i) * stride;
                for (int j = r; block && j < v; j++) normal[j] *= far;
                sizes[i] = norm(normal, v);
                for (int j = 0; j < v; j++) normal[j] /= sizes[i];
            }
            // What is left this long is longer than the step that is allowed, see as_step, and more than rounding.
            const double allowed = tol_.CERTIFIED * scale_ / (tol_.MARGIN * min(block ? 1.0 / block->strength : 1.0, far));
            const double most = allowed + tol_.ROUNDING * g.terms + leak;
            if (!balance(normals, n, look.held, v, g.values, most, combination)) {
                const auto is_negative = [](double share) { return share < 0.0; };
                look.is_of_all = !look.held && std::any_of(combination, combination + n, is_negative);
                return false;
            }
        }
        const int n = look.n;

        // What is left of the gradient; where that is not nothing yet, the combination is improved by what is left.
        double* rest = look.rest = arena_.zeros(stride);
        balance_left(at, own, look);
        look.excess = as_step(at, far, rest);
        for (int again = 0; again < IMPROVEMENTS && n && look.excess > tol_.MARGIN * tol_.CERTIFIED * scale_; again++) {
            if (!improve(normals, n, look.held, v, rest, combination)) break;
            balance_left(at, own, look);
            look.excess = as_step(at, far, rest);
        }

        // How much of the rest rounding can feign, and how far that reaches as a step.
        double *rough = look.rough = arena_.zeros(padded(v)), *beyond = look.beyond = arena_.doubles(padded(v));
        double net = 0.0, explained = 0.0;
        for (int j = 0; j < r; j++) rough[j] = tol_.ROUNDING * g.terms;
        for (int i = 0; i < n; i++) {
            const double *normal = normals + size_t(i) * stride, share = tol_.ROUNDING * abs(combination[i]);
            for (int j = 0; j < v; j++) rough[j] += share * abs(normal[j]);
            net += abs(combination[i]) / sizes[i];
        }
        for (int j = 0; j < v; j++) {
            const double size = j >= r ? far : block ? block->sizes[j] : 1.0;
            // What rows and levels above take of the gradient is more than what they leave, and so is its rounding.
            rough[j] += size * (blur_ * net + blur_as_given_ * 0.5 * g.steepness);
            beyond[j] = max(abs(rest[j]) - rough[j], 0.0);
            explained += size * size * rough[j] * rough[j];
        }
        look.explained = max(sqrt(explained), block ? leak * block->longest : 0.0);
        return true;
    }

    // How far a slack can be off: its sum is rounded, and the row may have been.
    double rounding_of_slacks() const { return (is_rounded_ ? 1.0 : 0.5) * tol_.EPS * size_; }

    // How long a step rounding of doubles can feign at most.
    double feigned(const Look& look) const { return max(look.explained, tol_.CERTIFIED * scale_ / tol_.MARGIN); }

    // Lists the rows that move in what is left.
    void gather(const Multipliers& own, const Span& at, Look& look) {
        look.n = 0;
        for (int pass = 0; pass < 2; pass++) {
            for (int i = 0; i < own.known; i++) {
                if ((own.leak[i] < INFINITE) != (pass == 0)) continue;
                const double moves = norm(own.row[i] + at.start, at.all());
                if (may_be_settled(moves, settled_)) doubt_ = true;
                if (moves > settled_) look.place[look.n++] = i;
            }
            if (pass == 0) look.held = look.n;
        }
    }

    // rest := the gradient with the combination of rows added. The rows are summed before the level's coordinates are
    // changed, as each by itself would leave more rounding than rows that nearly cancel leave of each other.
    void balance_left(const Span& at, const Multipliers& own, const Look& look) {
        double* rest = look.rest;
        clear(rest, stride);
        for (int i = 0; i < look.n; i++)
            if (const double share = look.combination[i]; share != 0.0)
                add(share / look.sizes[i], own.row[look.place[i]] + at.start, rest, at.all());
        if (at.block) {
            at.block->R.solve_transposed(rest);
            for (int j = at.rank; j < at.all(); j++) rest[j] *= look.far;
        }
        for (int j = 0; j < at.rank; j++) rest[j] += look.gradient[j];
    }

    // How long a step is that a gradient in a level's coordinates asks for.
    double as_step(const Span& at, double far, const double* rest) {
        Scope scope(arena_);
        double* step = arena_.zeros(stride);
        copy(rest, step, at.rank);
        if (at.block) at.block->R.solve(step);
        const double unfelt = far * norm(rest + at.rank, at.below);
        return sqrt(dot(step, step, at.rank) + unfelt * unfelt);
    }

    // The same with more digits, from the rows as they are given; says in `mends_` whether the step is off by so little
    // that it is to be mended. Nothing of soft levels.
    void look_closer(const Multipliers& own, const Span& at, int level, const Gradient& g, Look& look) {
        constexpr int TURNS = 2, IMPROVEMENTS = 4;
        const Block* block = at.block;
        const double most = feigned(look);
        if (block && block->is_soft) return;
        const int r = at.rank, v = at.all();
        const double* const* rows = block ? counted(*block) : nullptr;

        // Directions in which the cost is |.|^2; those below are as unfelt as digits allow.
        const double far = look.far = block ? max(block->longest, block->shortest / tol_.UNFELT) : 1.0;
        double* basis = arena_.zeros(size_t(v) * stride);
        if (block) felt_of(*block, basis);
        else copy(directions() + size_t(at.start) * stride, basis, size_t(r) * stride);
        for (int j = r; j < v; j++) add(far, directions() + size_t(at.start + j) * stride, basis + size_t(j) * stride, stride);
        const Doubled exact = doubled(size_t(v) * stride);
        copy(basis, exact.high, size_t(v) * stride);
        const auto [turn, turn_as_given] = leave_above(level, exact, v, blur_, blur_as_given_);
        for (int j = r; j < v; j++)
            for (int turn = 0; turn < TURNS; turn++) leave_unfelt(*block, rows, basis, exact.from(size_t(j) * stride));

        const Doubled gradient = doubled(padded(v));
        double *blur = look.rough = arena_.zeros(padded(v)), *lacking = look.gradient = arena_.zeros(stride);
        gradient_along(exact, r, block, rows, gradient, blur);
        bool lacks = false;
        for (int j = 0; j < r; j++)
            if (abs(gradient.high[j]) > blur[j]) lacking[j] = gradient.high[j], lacks = true;

        gather(own, at, look);
        const int n = look.n;
        const int s = padded(v);
        const Doubled normals = doubled(size_t(n) * s), shares = doubled(n), rest = doubled(s);
        double *combination = look.combination, *left = look.rest, *change = arena_.doubles(n), *net = arena_.zeros(padded(v));
        for (int i = 0; i < n; i++) {
            const Doubled normal = normals.from(size_t(i) * s);
            double* rounded = look.normals + size_t(i) * stride;
            const double given = along(own.ids[look.place[i]], exact, at.start, v, normal);
            const double size = norm(normal.high, v), scale = 1.0 / size;
            look.sizes[i] = size / given;  // of a row of unit length
            for (int j = 0; j < v; j++) {
                normal.set(j, scale * normal[j]);
                rounded[j] = normal.high[j];
            }
        }
        for (int i = 0; i < n; i++) combination[i] = 0.0;
        if (lacks && !balance(look.normals, n, look.held, v, lacking, INFINITE, combination)) return;

        const auto balance_exactly = [&] {
            copy(gradient.high, rest.high, s);
            copy(gradient.low, rest.low, s);
            for (int i = 0; i < n; i++)
                if (shares.high[i] != 0.0) add(shares[i], normals.from(size_t(i) * s), rest, v);
            for (int j = 0; j < v; j++) left[j] = rest[j].rounded();
        };
        for (bool is_signed = true; is_signed;) {
            copy(combination, shares.high, n);
            clear(shares.low, n);
            balance_exactly();
            for (int again = 0; again < IMPROVEMENTS && correct(look.normals, n, v, left, combination, change); again++) {
                for (int i = 0; i < n; i++) shares.set(i, shares[i] + DoubleDouble{change[i]});
                balance_exactly();
            }
            // A share that is rounding has any sign, and takes from the others as much: it is left out.
            is_signed = false;
            for (int i = look.held; i < n; i++)
                if (shares.high[i] < 0.0) combination[i] = 0.0, is_signed = true;
        }
        copy(shares.high, combination, n);

        double pulled = 0.0, explained = 0.0;
        for (int i = 0; i < n; i++) {
            const double share = abs(combination[i]);
            pulled += share / look.sizes[i];
            for (int j = 0; j < v; j++) net[j] += share * abs(look.normals[size_t(i) * stride + j]);
        }
        double* step = arena_.zeros(stride);
        for (int j = 0; j < v; j++) {
            const double size = j >= r ? far : block ? block->sizes[j] : 1.0;
            blur[j] += tol_.ROUNDING * FINER * net[j] + size * (turn * pulled + turn_as_given * 0.5 * g.steepness);
            look.beyond[j] = max(abs(left[j]) - blur[j], 0.0);
            explained += size * size * blur[j] * blur[j];
            add(-left[j], basis + size_t(j) * stride, step, stride);
        }
        look.explained = sqrt(explained);
        look.excess = norm(step, m_);
        closest_ = max(closest_, look.explained / scale_);
        if (look.excess > tol_.MARGIN * tol_.CERTIFIED * scale_ && look.excess <= most) {
            copy(step, mend_, stride);
            mends_ = true;
        }
    }

    // Adds to a combination what balances the rest in least squares; false, and no change, if a sign would be wrong.
    bool improve(const double* normals, int n, int held, int v, const double* rest, double* combination) {
        Scope scope(arena_);
        double* change = arena_.doubles(n);
        if (!correct(normals, n, v, rest, combination, change)) return false;
        for (int i = held; i < n; i++)
            if (combination[i] != 0.0 && combination[i] + change[i] < 0.0) return false;
        for (int i = 0; i < n; i++) combination[i] += change[i];
        return true;
    }

    // change := what balances the rest in least squares by the rows of a combination; false if there are none.
    bool correct(const double* normals, int n, int v, const double* rest, const double* combination, double* change) {
        Scope scope(arena_);
        for (int i = 0; i < n; i++) change[i] = 0.0;
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
        for (int j = 0; j < rank; j++) change[ids[order[j]]] = side[j];
        return rank > 0;
    }

    // The combination of normals (n), of either sign for the first `held`, that balances the gradient best; false if there is
    // none that leaves `most` or less.
    bool balance(const double* normals, int n, int held, int v, const double* gradient, double most, double* combination) {
        for (int i = 0; i < n; i++) combination[i] = 0.0;
        if (!n) return true;
        Scope scope(arena_);
        double* side = arena_.zeros(stride);
        for (int j = 0; j < v; j++) side[j] = -gradient[j];
        if (!held) return nonnegative_least_squares(normals, stride, n, v, side, combination, most, arena_);
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
            if (!nonnegative_least_squares(shorter, s, others, left, target, combination + held, most, arena_)) return false;
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
    bool pulls(const Multipliers& own, const Span& at, const Look& look) {
        Scope scope(arena_);
        const int n = look.n, held = look.held, v = at.all(), *place = look.place;
        const double* normals = look.normals;
        if (look.is_of_all && std::all_of(place, place + n, [&](int i) { return active_[own.ids[i]]; })) {
            for (int i = 0; i < n; i++)
                if (look.combination[i] < 0.0) wrong_.push_back(i);
            const auto pulls_more = [&](int i, int j) { return look.combination[i] < look.combination[j]; };
            std::sort(wrong_.begin(), wrong_.end(), pulls_more);
            for (int& i : wrong_) i = own.ids[place[i]];
            return false;
        }
        double* columns = arena_.zeros(size_t(n + 1) * stride);
        int *rows = arena_.array<int>(n), *order = arena_.array<int>(n), *places = arena_.array<int>(n), k = 0;
        for (int i = 0; i < n; i++)
            if (active_[own.ids[place[i]]]) {
                copy(normals + size_t(i) * stride, columns + size_t(k) * stride, v);
                rows[k++] = i;
            }
        double* side = columns + size_t(k) * stride;
        for (int j = 0; j < v; j++) side[j] = -look.gradient[j];
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

    double* multipliers_ = nullptr;
    uint8_t* active_ = nullptr;
    std::vector<int> wrong_;  // active rows to drop in turn
    double* mend_ = nullptr;  // what the step lacks by rounding,
    bool mends_ = false;      // if that is why the last proof did not end
    double closest_ = 0.0;    // how far rounding may move the step where the last proof looked closer, of the step

  private:
    std::vector<double> proof_;
    bool closely_ = false;
    // How far what levels above leave may be turned by rounding, for rows and for levels, and by half a unit of what is given.
    double blur_ = 0.0, blur_as_given_ = 0.0, given_ = 0.0, off_ = 0.0, above_ = 0.0, handed_ = 0.0;
};

}  // namespace prioritized_ik
