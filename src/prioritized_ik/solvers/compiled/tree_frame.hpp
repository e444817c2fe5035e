// The directions left to a level of a kinematic tree, and how it parts them: solvers/tree/frames.py, which says what and why;
// names are the same.
#pragma once

#include "tree_stages.hpp"

namespace prioritized_ik {

// A matrix somewhere, row by row.
struct View {
    const double* at = nullptr;
    int stride = 0;
    const double* row(int i) const { return at + size_t(i) * stride; }
};

// One step of a frame's flow, and what the level made of it. The first frame's flow and inputs are the stages' own.
struct LevelStep {
    int stage;                      // or -1 at the end
    int d, d_before, inputs;        // sizes of x here and just before, and of z
    View flow, in, twist;           // F (d, d_before), G (d, inputs), T (6, d)
    int in_at;                      // where z starts
    int before, decided, left;      // sizes of w just before, of e and of w
    int e_at;                       // where e starts
    size_t turn, moved, state;      // Q (c, c), M (d, e) and N (d, w), in the pool, rows padded
    int f_at;                       // where f starts, in the order of the frame below
    int own, own_end, rows;         // its rows among the sorted ones; those met in all
    int squeezed, handed;           // reflectors that left fewer of them; how many were left
    size_t tape, root;              // reflectors, each after its factor; [R S], rows padded

    int size() const { return before + inputs; }
    int width() const { return padded(size()); }
    int turned() const { return inputs + before - decided - left; }  // size of f
};

class Frame {
  public:
    std::vector<LevelStep> steps;
    std::vector<int> sorted;  // the level's rows, by stage
    int inputs = 0;           // size of z
    bool is_first = false;

    static constexpr double TINY = 1e-14;  // of frames.py

    // The first frame: twists of stages, driven by joints that are not fixed.
    void start(const TreeInput& in, const Stages& stages) {
        is_first = true;
        steps.resize(stages.all.size() + 1);
        first_axes_.resize(stages.axes.size());
        int before = 0, at = 0;
        for (size_t k = 0; k < steps.size(); k++) {
            LevelStep& step = steps[k];
            step = LevelStep{};
            step.stage = k + 1 < steps.size() ? int(k) : -1;
            step.d = step.stage < 0 ? 0 : TWIST * stages.all[k].states;
            step.d_before = before;
            step.in_at = at;
            if (step.stage >= 0) {
                const Stage& stage = stages.all[k];
                for (int i = 0; i < stage.count; i++)
                    if (!in.fixed[stages.joints[stage.joints + i]]) {
                        copy(stages.axis(stage, i), first_axes_.data() + size_t(TWIST) * at++, TWIST);
                        step.inputs++;
                    }
            }
            before = step.d;
        }
        inputs = at;
    }

    // The frame of what a level leaves.
    void start(const Frame& above) {
        is_first = false;
        const int count = int(above.steps.size());
        steps.resize(count);
        int at = 0;
        size_t need = 0;
        for (const LevelStep& from : above.steps) need += size_t(TWIST + from.before) * padded(from.left);
        moves_.resize(need);
        double* place = moves_.data();
        for (int k = 0; k < count; k++) {
            const LevelStep& from = above.steps[count - 1 - k];
            LevelStep& step = steps[k];
            step = LevelStep{};
            step.d = from.before;
            step.d_before = from.left;
            step.inputs = from.turned();
            const double* turn = above.pool_.data() + from.turn;
            step.flow = {place, padded(from.left)};
            for (int i = 0; i < from.before; i++, place += step.flow.stride) {
                copy(turn + size_t(i) * from.width() + from.decided, place, from.left);
                clear(place + from.left, step.flow.stride - from.left);
            }
            step.in = {turn + from.decided + from.left, from.width()};
            step.in_at = at;
            at += step.inputs;
            step.stage = -1;
            if (k + 1 == count) continue;
            const LevelStep& earlier = above.steps[count - 2 - k];
            step.stage = earlier.stage;
            const View state{above.pool_.data() + earlier.state, padded(earlier.left)};
            if (above.is_first) {
                step.twist = state;
                continue;
            }
            step.twist = {place, state.stride};
            for (int i = 0; i < TWIST; i++, place += state.stride)
                combine(earlier.twist.row(i), state.at, state.stride, earlier.d, place, state.stride);
        }
        inputs = at;
    }

    // Parts every step by the rows, if any; returns how many directions these decide.
    int part(const TreeInput& in, const Stages& stages) {
        pool_.clear();
        most_ = 0;
        int decided = 0, at = 0;
        starts_.assign(stages.all.size() + 1, 0);
        for (int row : sorted) starts_[stages.of_row[row] + 1]++;
        for (size_t n = 0; n < stages.all.size(); n++) starts_[n + 1] += starts_[n];
        for (size_t k = 0; k < steps.size(); k++) {
            LevelStep& step = steps[k];
            if (step.stage >= 0) step.own = starts_[step.stage], step.own_end = starts_[step.stage + 1];
            step.e_at = decided;
            part(in, stages, step, k ? &steps[k - 1] : nullptr);
            most_ = max(most_, max(step.width(), max(padded(step.d), padded(step.decided + step.d_before))));
            decided += step.decided;
        }
        for (size_t k = steps.size(); k-- > 0;) {
            steps[k].f_at = at;
            at += steps[k].turned();
        }
        return decided;
    }

    // z -> e, f; f in the order of the frame below.
    void split(const double* z, double* e, double* f) {
        double *given = buffer(most_), *out = given + most_;  // w and z of a step; e, w and f
        for (const LevelStep& step : steps) {
            const int width = step.width();
            copy_few(z + step.in_at, given + step.before, step.inputs);
            combine(given, pool_.data() + step.turn, width, step.size(), out, width);
            if (step.decided) copy_few(out, e + step.e_at, step.decided);
            copy_few(out + step.decided, given, step.left);
            copy_few(out + step.decided + step.left, f + step.f_at, step.turned());
        }
    }

    // e, f -> z; zero where null.
    void join(const double* e, const double* f, double* z) {
        double *w = buffer(most_), *in = w + most_;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            const int c = step.size(), width = step.width();
            clear(in, width);
            if (e) copy_few(e + step.e_at, in, step.decided);
            copy_few(w, in + step.decided, step.left);
            if (f) copy_few(f + step.f_at, in + step.decided + step.left, step.turned());
            const double* turn = pool_.data() + step.turn;
            for (int i = 0; i < c; i++) {
                const double value = dot(turn + size_t(i) * width, in, width);
                if (i < step.before) w[i] = value;
                else z[step.in_at + i - step.before] = value;
            }
        }
    }

    size_t memory() const {
        return sizeof(double) * (pool_.capacity() + moves_.capacity() + first_axes_.capacity() + work_.capacity()) +
               sizeof(LevelStep) * steps.capacity() + sizeof(int) * (sorted.capacity() + starts_.capacity());
    }

  protected:
    // Room for two of a size; no two functions use it at once.
    double* buffer(int size) {
        if (int(buffer_.size()) < 2 * padded(size) + LANES) buffer_.resize(size_t(2) * padded(size) + LANES);
        return buffer_.data();
    }

    // A row on a stage's twist as one on x (d, padded).
    void row_here(const LevelStep& step, const double* given, double factor, double* x) const {
        if (is_first) {
            clear(x + TWIST, step.d - TWIST);
            for (int i = 0; i < TWIST; i++) x[i] = factor * given[i];
            return;
        }
        double scaled[TWIST];
        for (int i = 0; i < TWIST; i++) scaled[i] = factor * given[i];
        combine(scaled, step.twist.at, step.twist.stride, TWIST, x, padded(step.d));
    }

    // An entry of G.
    double input(const LevelStep& step, int row, int column) const {
        if (!is_first) return step.in.row(row)[column];
        return row < TWIST ? first_axes_[size_t(TWIST) * (step.in_at + column) + row] : 0.0;
    }

    // to (d) := F from (d_before)
    void flow(const Stages& stages, const LevelStep& step, const double* from, double* to) const {
        if (!is_first) {
            for (int i = 0; i < step.d; i++) to[i] = dot(step.flow.row(i), from, step.d_before);
            return;
        }
        if (step.stage < 0) return;
        const Stage& stage = stages.all[step.stage];
        for (int b = 0; b < stage.states; b++) {
            const int place = stages.kept[stage.kept + b];
            if (place < 0) clear(to + TWIST * b, TWIST);
            else if (b == 0) move_twist(from + TWIST * place, stage.arm, to);
            else copy(from + TWIST * place, to + TWIST * b, TWIST);
        }
    }

    // to (d_before, padded) := row (d) F
    void flow_back(const Stages& stages, const LevelStep& step, const double* row, double* to) const {
        if (!is_first) return combine(row, step.flow.at, step.flow.stride, step.d, to, padded(step.d_before));
        clear(to, step.d_before);
        if (step.stage < 0) return;
        const Stage& stage = stages.all[step.stage];
        for (int b = 0; b < stage.states; b++) {
            const int place = stages.kept[stage.kept + b];
            if (place < 0) continue;
            double moved[TWIST];
            if (b == 0) move_row(row, stage.arm, moved);
            else copy(row + TWIST * b, moved, TWIST);
            for (int i = 0; i < TWIST; i++) to[TWIST * place + i] += moved[i];
        }
    }

    // whole (d, c) := [F N_before, G]
    void gather(const Stages& stages, const LevelStep& step, const LevelStep* prior, double* whole) const {
        const int w = step.width(), before = step.before, stride = padded(before);
        const double* N = prior ? pool_.data() + prior->state : nullptr;
        if (!is_first)
            for (int i = 0; i < step.d; i++) combine(step.flow.row(i), N, stride, step.d_before, whole + size_t(i) * w, stride);
        else if (step.stage >= 0) {
            const Stage& stage = stages.all[step.stage];
            for (int b = 0; b < stage.states; b++) {
                const int place = stages.kept[stage.kept + b];
                if (place < 0) continue;
                double* to = whole + size_t(TWIST) * b * w;
                for (int i = 0; i < TWIST; i++) copy(N + size_t(TWIST * place + i) * stride, to + size_t(i) * w, before);
                if (b > 0) continue;
                const double* a = stage.arm;
                for (int i = 0; i < 3; i++) {  // v + w x a
                    const int p = (i + 1) % 3, q = (i + 2) % 3;
                    add(a[q], to + size_t(p) * w, to + size_t(3 + i) * w, before);
                    add(-a[p], to + size_t(q) * w, to + size_t(3 + i) * w, before);
                }
            }
        }
        const int most = is_first ? min(step.d, TWIST) : step.d;
        for (int i = 0; i < most; i++)
            for (int j = 0; j < step.inputs; j++) whole[size_t(i) * w + before + j] = input(step, i, j);
    }

    // How far components of x move at most, in spread_; kept from step to step of the first frame.
    void spread_here(const Stages& stages, const LevelStep& step) {
        if (!is_first || step.stage < 0) {
            spread_.assign(step.d, 1.0);
            return;
        }
        const Stage& stage = stages.all[step.stage];
        other_spread_.resize(step.d);
        copy(stages.spread.data() + size_t(TWIST) * step.stage, other_spread_.data(), TWIST);
        for (int b = 1; b < stage.states; b++)
            copy(spread_.data() + TWIST * stages.kept[stage.kept + b], other_spread_.data() + TWIST * b, TWIST);
        spread_.swap(other_spread_);
    }

    // See `frames.part`.
    void part(const TreeInput& in, const Stages& stages, LevelStep& step, const LevelStep* prior) {
        step.before = prior ? prior->left : 0;
        const int c = step.size(), w = step.width(), d = step.d, n = step.own_end - step.own;
        work_.assign(size_t(c + d + n) * w + padded(d) + LANES, 0.0);
        double *turn = work_.data(), *whole = turn + size_t(c) * w, *rows = whole + size_t(d) * w, *x = rows + size_t(n) * w;
        for (int i = 0; i < c; i++) turn[size_t(i) * w + i] = 1.0;
        gather(stages, step, prior, whole);
        zeros_.resize(max(n, d));
        scales_.assign(max(n, d), 1.0);
        for (int i = 0; i < n; i++) {
            const int row = sorted[step.own + i];
            zeros_[i] = stages.zeros[row];
            row_here(step, stages.row(row), 1.0 / in.lengths[row], x);
            combine(x, whole, w, is_first ? min(TWIST, d) : d, rows + size_t(i) * w, w);
        }
        step.decided = lq(rows, n, 0, c, w, c + d + n);
        spread_here(stages, step);
        for (int i = 0; i < d; i++) zeros_[i] = TINY, scales_[i] = spread_[i] > 0.0 ? 1.0 / spread_[i] : 1.0;
        step.left = lq(whole, d, step.decided, c, w, c + d) - step.decided;
        step.turn = saved(turn, c, w, w);
        step.moved = saved(whole, d, w, step.decided);
        step.state = saved(whole + step.decided, d, w, step.left);
    }

    // Copies `columns` of rows (n) of a stride to the pool, padded by zeros.
    size_t saved(const double* rows, int n, int stride, int columns) {
        const size_t at = pool_.size();
        const int width = padded(columns);
        pool_.resize(at + size_t(n) * width, 0.0);
        for (int i = 0; i < n; i++) copy(rows + size_t(i) * stride, pool_.data() + at + size_t(i) * width, columns);
        return at;
    }

    // See `row_pivoted_lq`; `all` rows of work_ are turned. Returns the column after the last that a row depends on.
    int lq(double* rows, int n, int from, int c, int w, int all) {
        vector_.resize(w);
        int done = from;
        for (; done < c && done - from < n; done++) {
            int best = -1;
            double most = 0.0;
            for (int i = 0; i < n; i++) {
                const double size = length_from(rows + size_t(i) * w, done, w) * scales_[i];
                if (size > zeros_[i] && size > most) most = size, best = i;
            }
            if (best < 0) break;
            double *row = rows + size_t(best) * w, *v = vector_.data(), tau;
            clear(v, w);
            const double beta = reflector(row + done, v + done, c - done, tau);
            reflect_all(aligned_start(done), w, all, tau);
            row[done] = beta;
            clear(row + done + 1, c - done - 1);
        }
        return done;
    }

    // Turns `all` rows of work_ (w) by the reflector in vector_, which is zero before `start`.
    void reflect_all(int start, int w, int all, double tau) {
        const double* v = vector_.data();
        int i = 0;
        for (; i + 4 <= all; i += 4) {
            double *a = work_.data() + size_t(i) * w, *b = a + w, *c = b + w, *d = c + w;
            Wide p = {}, q = {}, r = {}, s = {};
            for (int j = start; j < w; j += WIDE) {
                const Wide x = wide(v + j);
                p += wide(a + j) * x, q += wide(b + j) * x, r += wide(c + j) * x, s += wide(d + j) * x;
            }
            const Four factors = totals(p, q, r, s) * -tau;
            for (int j = start; j < w; j += WIDE) {
                const Wide x = wide(v + j);
                wide(a + j) += wide_of(factors[0]) * x, wide(b + j) += wide_of(factors[1]) * x;
                wide(c + j) += wide_of(factors[2]) * x, wide(d + j) += wide_of(factors[3]) * x;
            }
        }
        for (; i < all; i++) reflect(work_.data() + size_t(i) * w + start, v + start, tau, w - start);
    }

    // Length of a row (w) from a column on.
    static double length_from(const double* row, int first, int w) {
        static constexpr double counts[] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1};
        const int start = aligned_start(first);
        const Wide counted = wide(row + start) * wide(counts + 8 + start - first);
        Wide sum = counted * counted;
        for (int j = start + WIDE; j < w; j += WIDE) sum += wide(row + j) * wide(row + j);
        return sqrt(total(folded(sum)));
    }

    int most_ = 0;  // numbers of a step
    std::vector<int> starts_;
    std::vector<double> pool_, moves_, first_axes_, work_, buffer_, vector_, zeros_, scales_, spread_, other_spread_;
};

}  // namespace prioritized_ik
