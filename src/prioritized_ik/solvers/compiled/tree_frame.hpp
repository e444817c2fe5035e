// The directions left to a level of a kinematic tree, and how it parts them: solvers/tree/frames.py, which says what and why;
// names are the same.
#pragma once

#include "tree_stages.hpp"

namespace prioritized_ik {

// A matrix somewhere, column by column.
struct View {
    const double* at = nullptr;
    int stride = 0;
    const double* column(int j) const { return at + size_t(j) * stride; }
};

// Memory that grows and is not given back; what is taken holds anything.
class Pool {
  public:
    void clear() { used_ = 0; }
    size_t take(size_t n) {
        const size_t at = used_;
        used_ += n;
        if (used_ > memory_.size()) memory_.resize(max(used_, 2 * memory_.size()));
        return at;
    }
    void shrink(size_t used) { used_ = used; }
    double* at(size_t place) { return memory_.data() + place; }
    const double* at(size_t place) const { return memory_.data() + place; }
    size_t memory() const { return sizeof(double) * memory_.capacity(); }

  private:
    std::vector<double> memory_;
    size_t used_ = 0;
};

// One step of a frame's flow, and what the level made of it: an orthogonal matrix of (w just before, z), c of them, to
// (e, w, f), and what these do to x. It stands in the pool column by column, that of an e, w or f after the other: its part
// of the c, then of x (d). The first frame's flow and inputs are the stages' own.
struct LevelStep {
    int stage;                      // or -1 at the end
    int d, d_before, inputs;        // sizes of x here and just before, and of z
    View flow, in, twist;           // F (d, d_before), G (d, inputs), T (6, d)
    int in_at;                      // where z starts
    int before, decided, left;      // sizes of w just before, of e and of w
    int e_at;                       // where e starts
    int lanes;                      // from one column to the next
    size_t columns;                 // where they are in the pool
    int f_at;                       // where f starts, in the order of the frame below
    int own, own_end, rows;         // its rows among the sorted ones; those met in all
    int squeezed, handed;           // reflectors that left fewer of them; how many were left
    size_t tape, root;              // reflectors, each after its factor; [R S], rows padded

    int size() const { return before + inputs; }
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
        for (const LevelStep& from : above.steps) need += size_t(padded(TWIST)) * from.left;
        moves_.resize(need);
        double* place = moves_.data();
        for (int k = 0; k < count; k++) {
            const LevelStep& from = above.steps[count - 1 - k];
            LevelStep& step = steps[k];
            step = LevelStep{};
            step.d = from.before;
            step.d_before = from.left;
            step.inputs = from.turned();
            step.flow = {above.column(from, from.decided), from.lanes};
            step.in = {above.column(from, from.decided + from.left), from.lanes};
            step.in_at = at;
            at += step.inputs;
            step.stage = -1;
            if (k + 1 == count) continue;
            const LevelStep& earlier = above.steps[count - 2 - k];
            step.stage = earlier.stage;
            const double* state = above.column(earlier, earlier.decided) + earlier.size();
            if (above.is_first) {
                step.twist = {state, earlier.lanes};
                continue;
            }
            step.twist = {place, padded(TWIST)};
            for (int j = 0; j < earlier.left; j++, place += padded(TWIST), state += earlier.lanes)
                combine(state, earlier.twist.at, earlier.twist.stride, earlier.d, place, padded(TWIST));
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
            most_ = max(most_, WIDE + max(padded(step.size()), max(padded(step.d), padded(step.decided + step.d_before))));
            decided += step.decided;
        }
        const size_t end = pool_.take(2 * WIDE);  // that vector instructions may read beyond the last column
        clear(pool_.at(end), 2 * WIDE);
        for (size_t k = steps.size(); k-- > 0;) {
            steps[k].f_at = at;
            at += steps[k].turned();
        }
        return decided;
    }

    // z -> e, f; f in the order of the frame below. Of doubles, or two at once.
    template <class T> void split(const T* z, T* e, T* f) {
        T *given = buffer<T>(most_), *out = given + most_;  // w and z of a step; e, w and f
        for (const LevelStep& step : steps) {
            const int c = step.size(), width = padded(c);
            copy_few(z + step.in_at, given + step.before, step.inputs);
            const double* column = this->column(step, 0);
            if constexpr (std::is_same_v<T, double>) {
                clear_few(given + c, width - c);
                for (int j = 0; j < c; j++, column += step.lanes) out[j] = dot(given, column, width);
            } else
                for (int j = 0; j < c; j++, column += step.lanes) out[j] = summed(given, column, c);
            copy_few(out, e + step.e_at, step.decided);
            copy_few(out + step.decided, given, step.left);
            copy_few(out + step.decided + step.left, f + step.f_at, step.turned());
        }
    }

    // e, f -> z; zero where null. Of doubles, or two at once.
    template <class T> void join(const T* e, const T* f, T* z) {
        T *w = buffer<T>(most_), *in = w + most_;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            const int c = step.size(), first = step.decided + step.left;
            if (e) copy_few(e + step.e_at, in, step.decided);
            else clear_few(in, step.decided);
            copy_few(w, in + step.decided, step.left);
            if constexpr (std::is_same_v<T, double>) {
                combine(in, column(step, 0), step.lanes, first, w, padded(c));
                if (f) add_columns(f + step.f_at, column(step, first), step.lanes, step.turned(), w, padded(c));
            } else {
                clear_few(w, c);
                const double* column = this->column(step, 0);
                for (int j = 0; j < (f ? c : first); j++, column += step.lanes) {
                    const T value = j < first ? in[j] : f[step.f_at + j - first];
                    for (int i = 0; i < c; i++) w[i] += value * column[i];
                }
            }
            copy_few(w + step.before, z + step.in_at, step.inputs);
        }
    }

    size_t memory() const {
        return pool_.memory() + sizeof(double) * (moves_.capacity() + first_axes_.capacity() + work_.capacity()) +
               sizeof(LevelStep) * steps.capacity() + sizeof(int) * (sorted.capacity() + starts_.capacity());
    }

  protected:
    // Room for two of a size; no two functions use it at once.
    template <class T> T* buffer(int size) {
        const size_t need = (size_t(2) * padded(size) + LANES) * (sizeof(T) / sizeof(double));
        if (buffer_.size() < need) buffer_.resize(need);
        return reinterpret_cast<T*>(buffer_.data());
    }

    template <class T> static T summed(const T* values, const double* factors, int n) {
        T sum = {};
        for (int i = 0; i < n; i++) sum += values[i] * factors[i];
        return sum;
    }

    double* column(const LevelStep& step, int j) { return pool_.at(step.columns + size_t(j) * step.lanes); }
    const double* column(const LevelStep& step, int j) const { return pool_.at(step.columns + size_t(j) * step.lanes); }

    // What e, w or f of a number does to x (d).
    const double* moved(const LevelStep& step, int j) const { return column(step, j) + step.size(); }

    // A row on a stage's twist as one on x (d).
    void row_here(const LevelStep& step, const double* given, double factor, double* x) const {
        if (is_first) {
            for (int i = 0; i < TWIST; i++) x[i] = factor * given[i];
            clear(x + TWIST, step.d - TWIST);
        } else
            for (int j = 0; j < step.d; j++) x[j] = factor * product(given, step.twist.column(j));
    }

    // A column of G (d), which is zero beyond `TWIST` in the first frame.
    const double* input(const LevelStep& step, int j) const {
        return is_first ? first_axes_.data() + size_t(TWIST) * (step.in_at + j) : step.in.column(j);
    }
    int inputs_felt(const LevelStep& step) const { return is_first ? min(step.d, TWIST) : step.d; }

    // to (d, padded) := F from (d_before)
    template <class T> void flow(const Stages& stages, const LevelStep& step, const T* from, T* to) const {
        if (!is_first) {
            if constexpr (std::is_same_v<T, double>) return combine(from, step.flow.at, step.flow.stride, step.d_before, to, padded(step.d));
            clear_few(to, step.d);
            for (int j = 0; j < step.d_before; j++)
                for (int i = 0; i < step.d; i++) to[i] += from[j] * step.flow.column(j)[i];
            return;
        }
        if (step.stage < 0) return;
        const Stage& stage = stages.all[step.stage];
        for (int b = 0; b < stage.states; b++) {
            const int place = stages.kept[stage.kept + b];
            if (place < 0) clear_few(to + TWIST * b, TWIST);
            else if (b == 0) move_twist(from + TWIST * place, stage.arm, to);
            else copy_few(from + TWIST * place, to + TWIST * b, TWIST);
        }
    }

    // to (d_before) := row (d) F
    template <class T> void flow_back(const Stages& stages, const LevelStep& step, const T* row, T* to) const {
        if (!is_first) {
            for (int j = 0; j < step.d_before; j++) to[j] = summed(row, step.flow.column(j), step.d);
            return;
        }
        if (step.stage < 0) return clear_few(to, step.d_before);
        const Stage& stage = stages.all[step.stage];
        if (stage.states == 1 && step.d_before == TWIST && stages.kept[stage.kept] == 0) return move_row(row, stage.arm, to);
        clear_few(to, step.d_before);
        for (int b = 0; b < stage.states; b++) {
            const int place = stages.kept[stage.kept + b];
            if (place < 0) continue;
            T moved[TWIST];
            if (b == 0) move_row(row, stage.arm, moved);
            else copy_few(row + TWIST * b, moved, TWIST);
            for (int i = 0; i < TWIST; i++) to[TWIST * place + i] += moved[i];
        }
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
        const int c = step.size(), d = step.d, n = step.own_end - step.own, lanes = padded(c + d + n), kept = padded(c + d);
        work_.resize(max(work_.size(), size_t(c) * lanes + padded(d) + 2 * WIDE + padded(n)));
        double *work = work_.data(), *x = work + size_t(c) * lanes + WIDE;
        double* column = work;
        const int felt = inputs_felt(step);
        for (int j = 0; j < c; j++, column += lanes) {
            for (int i = 0; i < lanes; i += WIDE) wide(column + i) = Wide{};
            if (j < step.before) flow(stages, step, moved(*prior, prior->decided + j), column + c);
            else copy_few(input(step, j - step.before), column + c, felt);
            for (int i = 0; i < c; i++) column[i] = i == j;
        }
        squares_.resize(max(squares_.size(), size_t(lanes)));
        least_.resize(max(least_.size(), size_t(lanes)));
        scales_.resize(max(scales_.size(), size_t(lanes)));
        for (int i = 0; i < n; i++) {
            const int row = sorted[step.own + i];
            least_[c + d + i] = stages.zeros[row] * stages.zeros[row], scales_[c + d + i] = 1.0;
            row_here(step, stages.row(row), 1.0 / in.lengths[row], x);
            for (int j = 0; j < c; j++) {
                double* at = work + size_t(j) * lanes + c;
                double felt = 0.0;
                for (int k = 0; k < (is_first ? TWIST : d); k++) felt += x[k] * at[k];
                at[d + i] = felt;
            }
        }
        for (int i = 0; i < lanes; i += WIDE) {
            Wide sum = {};
            for (int j = 0; j < c; j++) sum += wide(work + size_t(j) * lanes + i) * wide(work + size_t(j) * lanes + i);
            wide(squares_.data() + i) = sum;
        }
        vector_.resize(max(vector_.size(), size_t(c)));
        step.decided = lq(c + d, n, 0, c, lanes);
        spread_here(stages, step);
        for (int i = 0; i < d; i++) {
            const double scale = spread_[i] > 0.0 ? 1.0 / spread_[i] : 1.0;
            least_[c + i] = TINY * TINY, scales_[c + i] = scale * scale;
        }
        step.left = lq(c, d, step.decided, c, lanes) - step.decided;
        step.lanes = kept;
        step.columns = pool_.take(size_t(c) * kept);
        double* to = pool_.at(step.columns);
        for (int j = 0; j < c; j++)
            for (int i = 0; i < kept; i += WIDE, to += WIDE) wide(to) = wide(work + size_t(j) * lanes + i);
    }

    // See `row_pivoted_lq`, of n rows among the `lanes` of work_, c columns, which stand one after the other; all are turned.
    // Returns the column after the last that a row depends on. In squares_ are those of the rows' lengths from a column on.
    int lq(int first, int n, int from, int c, int lanes) {
        double *work = work_.data(), *v = vector_.data(), *squares = squares_.data();
        int done = from;
        for (; done < c && done - from < n; done++) {
            int best = -1;
            double most = 0.0;
            for (int i = first; i < first + n; i++) {
                const double square = squares[i] * scales_[i];
                if (square > least_[i] && square > most) most = square, best = i;
            }
            if (best < 0) break;
            double* column = work + size_t(done) * lanes;
            const double head = column[best], size = sqrt(squares[best]), beta = head >= 0.0 ? -size : size;
            const double scale = 1.0 / (head - beta), tau = (beta - head) / beta;
            const int others = c - done - 1;
            for (int j = 0; j < others; j++) v[j] = column[size_t(j + 1) * lanes + best] * scale;
            int k = 0;
            for (; k + 2 * WIDE <= lanes; k += 2 * WIDE) turn<2>(column + k, lanes, others, v, tau, best - k, squares + k);
            if (k < lanes) turn<1>(column + k, lanes, others, v, tau, best - k, squares + k);
        }
        return done;
    }

    // Turns WIDTH registers full of rows by a reflector (1, v) of a column and the `others` that follow it. Of the row `best`
    // nothing is left in the others, to the last bit: where that is much less than what was, digits count. Notes the squares
    // of what rows have in the others.
    template <int WIDTH>
    static void turn(double* column, int lanes, int others, const double* v, double tau, int best, double* squares) {
        Wide sum[WIDTH], kept[WIDTH], square[WIDTH];
        for (int i = 0; i < WIDTH; i++) {
            sum[i] = wide(column + i * WIDE), square[i] = Wide{};
            const int place = best - i * WIDE;
            kept[i] = place >= 0 && place < WIDE ? wide(ALL_BUT_ONE + 8 - place) : wide_of(1.0);
        }
        const double* from = column + lanes;
        for (int j = 0; j < others; j++, from += lanes)
            for (int i = 0; i < WIDTH; i++) sum[i] += wide_of(v[j]) * wide(from + i * WIDE);
        for (int i = 0; i < WIDTH; i++) {
            sum[i] *= wide_of(tau);
            wide(column + i * WIDE) -= sum[i];
        }
        double* to = column + lanes;
        for (int j = 0; j < others; j++, to += lanes)
            for (int i = 0; i < WIDTH; i++) {
                const Wide left = (wide(to + i * WIDE) - wide_of(v[j]) * sum[i]) * kept[i];
                wide(to + i * WIDE) = left;
                square[i] += left * left;
            }
        for (int i = 0; i < WIDTH; i++) wide(squares + i * WIDE) = square[i];
    }

    static constexpr double ALL_BUT_ONE[] = {1, 1, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1, 1};
    static_assert(WIDE <= 8, "as many ones on both sides");

    int most_ = 0;  // numbers of a step
    std::vector<int> starts_;
    Pool pool_;
    std::vector<double> moves_, first_axes_, work_, buffer_, vector_, squares_, least_, scales_, spread_, other_spread_;
};

}  // namespace prioritized_ik
