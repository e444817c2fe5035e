// One level of a kinematic tree, factored: solvers/tree/triangle.py, which says what and why; names are the same.
#pragma once

#include "tree_frame.hpp"

namespace prioritized_ik {

class Level : public Frame {
  public:
    int rank = 0;  // size of e
    double strongest = 0.0, weakest = INFINITE;

    static constexpr double NEAR = 1e-10;  // of elimination.py

    // The frame of what a level leaves, turned so that it flows outwards.
    void start(const Level& above, const TreeInput& in, const Stages& stages) {
        is_turned_ = true;
        turn_.start(above);
        turn_.part(in, stages);
        Frame::start(turn_);
    }

    void start(const TreeInput& in, const Stages& stages) {
        is_turned_ = false;
        Frame::start(in, stages);
    }

    // Parts every step by rows `sorted`, and factors these.
    void factor(const TreeInput& in, const Stages& stages) {
        stages_ = &stages;
        tape_.clear();
        most_rows_ = 0, strongest = 0.0, weakest = INFINITE;
        rank = part(in, stages);
        int n = 0;
        View handed;
        for (size_t k = steps.size(); k-- > 0;) n = triangle(in, steps[k], n, handed);
    }

    // z -> e, f, of the frame before it was turned; see `Frame::split`.
    template <class T> void split(const T* z, T* e, T* f) {
        if (is_turned_) {
            T* turned = this->turned<T>();
            turn_.split(z, static_cast<T*>(nullptr), turned);
            z = turned;
        }
        Frame::split(z, e, f);
    }

    // e, f -> z, of the frame before it was turned; zero where null.
    template <class T> void join(const T* e, const T* f, T* z) {
        if (!is_turned_) return Frame::join(e, f, z);
        T* turned = this->turned<T>();
        Frame::join(e, f, turned);
        turn_.join(static_cast<const T*>(nullptr), turned, z);
    }

    // Q^T of right-hand sides (k).
    void from_sides(const double* sides, double* q) {
        double* y = buffer<double>(most_rows_);
        int n = 0;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            for (int i = step.own; i < step.own_end; i++) y[n++] = sides[sorted[i]];
            const double* tape = tape_.at(step.tape);
            for (int j = 0; j < step.decided + step.squeezed; j++) {
                reflect_values(tape + 1, tape[0], y + j, n - j);
                tape += n - j + 1;
            }
            copy(y, q + step.e_at, step.decided);
            n = step.handed;
            std::memmove(y, y + step.decided, sizeof(double) * n);
        }
    }

    // Q of what is whitened, to the level's rows in out (k).
    void pulls(const double* whitened, double* out) {
        double *y = buffer<double>(most_rows_), *other = y + padded(most_rows_);
        for (const LevelStep& step : steps) {
            const int n = step.rows, e = step.decided;
            copy(whitened + step.e_at, other, e);
            copy(y, other + e, step.handed);
            clear(other + e + step.handed, n - e - step.handed);
            const int reflectors = e + step.squeezed;
            const double* tape = tape_.at(step.tape) + reflectors * (n + 1) - reflectors * (reflectors - 1) / 2;
            for (int j = reflectors - 1; j >= 0; j--) {
                tape -= n - j + 1;
                reflect_values(tape + 1, tape[0], other + j, n - j);
            }
            const int before = n - (step.own_end - step.own);
            for (int i = step.own; i < step.own_end; i++) out[sorted[i]] = other[before + i - step.own];
            std::swap(y, other);
        }
    }

    // e := R^-1 q. Of doubles, or two at once.
    template <class T> void solve(const T* q, T* e) {
        T *t = buffer<T>(most_), *next = t + most_;
        for (const LevelStep& step : steps) {
            const double* root = pool_.at(step.root);
            const int width = padded(step.decided + step.d_before);
            T* own = e + step.e_at;
            for (int i = step.decided - 1; i >= 0; i--) {
                const double* row = root + size_t(i) * width;
                T value = q[step.e_at + i];
                for (int j = i + 1; j < step.decided; j++) value -= row[j] * own[j];
                for (int j = 0; j < step.d_before; j++) value -= row[step.decided + j] * t[j];
                own[i] = value / row[i];
            }
            flow(*stages_, step, t, next);
            for (int j = 0; j < step.decided; j++) {
                const double* moved = this->moved(step, j);
                const T factor = own[j];
                for (int i = 0; i < step.d; i++) next[i] += factor * moved[i];
            }
            std::swap(t, next);
        }
    }

    // out := R^-T of a gradient. Of doubles, or two at once.
    template <class T> void whiten(const T* gradient, T* out) {
        T *back = buffer<T>(most_), *next = back + most_;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            const double* root = pool_.at(step.root);
            const int e = step.decided, width = padded(e + step.d_before);
            T* own = out + step.e_at;
            for (int j = 0; j < e; j++) {
                const double* moved = this->moved(step, j);
                T value = gradient[step.e_at + j];
                for (int i = 0; i < step.d; i++) value -= back[i] * moved[i];
                for (int i = 0; i < j; i++) value -= root[size_t(i) * width + j] * own[i];
                own[j] = value / root[size_t(j) * width + j];
            }
            flow_back(*stages_, step, back, next);
            for (int i = 0; i < e; i++) {
                const double* row = root + size_t(i) * width + e;
                const T factor = own[i];
                for (int j = 0; j < step.d_before; j++) next[j] += factor * row[j];
            }
            std::swap(back, next);
        }
    }

    // See `Factors.count_below`: -1 if it is not clear.
    int count_below(const TreeInput& in, double tau) const {
        std::vector<double> S, both, half, M;
        const double square = tau * tau;
        int count = 0, d = 0;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            const int i = step.inputs, n = i + step.d_before;
            d = step.d;
            for (int r = step.own; r < step.own_end; r++) {
                const double* given = stages_->row(sorted[r]);
                std::vector<double>& x = half;
                x.assign(padded(d), 0.0);
                row_here(step, given, 1.0, x.data());
                for (int a = 0; a < d; a++)
                    for (int b = 0; b < d; b++) S[size_t(a) * d + b] += x[a] * x[b];
            }
            both.assign(size_t(d) * n, 0.0);  // [G F]
            std::vector<double>& unit = half;
            for (int b = 0; b < i; b++)
                for (int a = 0; a < inputs_felt(step); a++) both[size_t(a) * n + b] = input(step, b)[a];
            for (int b = 0; b < step.d_before; b++) {
                unit.assign(size_t(step.d_before) + padded(d), 0.0);
                unit[b] = 1.0;
                flow(*stages_, step, unit.data(), unit.data() + step.d_before);
                for (int a = 0; a < d; a++) both[size_t(a) * n + i + b] = unit[step.d_before + a];
            }
            half.assign(size_t(d) * n, 0.0);
            for (int a = 0; a < d; a++)
                for (int b = 0; b < d; b++)
                    if (const double s = S[size_t(a) * d + b]; s != 0.0)
                        for (int c = 0; c < n; c++) half[size_t(a) * n + c] += s * both[size_t(b) * n + c];
            M.assign(size_t(n) * n, 0.0);
            for (int a = 0; a < d; a++)
                for (int b = 0; b < n; b++)
                    if (const double s = both[size_t(a) * n + b]; s != 0.0)
                        for (int c = 0; c < n; c++) M[size_t(b) * n + c] += s * half[size_t(a) * n + c];
            for (int a = 0; a < i; a++) M[size_t(a) * n + a] -= square;
            for (int p = 0; p < i; p++) {
                const double* row = M.data() + size_t(p) * n;
                const double pivot = row[p];
                if (abs(pivot) <= NEAR * (abs(pivot + square) + square)) return -1;
                count += pivot < 0.0;
                for (int a = p + 1; a < n; a++) {
                    const double factor = M[size_t(a) * n + p] / pivot;
                    if (factor != 0.0)
                        for (int b = p + 1; b < n; b++) M[size_t(a) * n + b] -= factor * row[b];
                }
            }
            S.assign(size_t(step.d_before) * step.d_before, 0.0);
            for (int a = i; a < n; a++)
                for (int b = i; b < n; b++) S[size_t(a - i) * step.d_before + b - i] = M[size_t(a) * n + b];
        }
        return count;
    }

    size_t memory() const { return Frame::memory() + turn_.memory() + tape_.memory(); }

  private:
    // Room for inputs.
    template <class T> T* turned() {
        turned_.resize(max(turned_.size(), inputs * (sizeof(T) / sizeof(double))));
        return reinterpret_cast<T*>(turned_.data());
    }

    static void reflect_values(const double* v, double factor, double* y, int n) {
        double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
        int i = 0;
        for (; i + 4 <= n; i += 4) a += v[i] * y[i], b += v[i + 1] * y[i + 1], c += v[i + 2] * y[i + 2], d += v[i + 3] * y[i + 3];
        for (; i < n; i++) a += v[i] * y[i];
        const double sum = factor * ((a + c) + (b + d));
        for (i = 0; i < n; i++) y[i] -= sum * v[i];
    }

    // See `Triangle`: n rows are handed on to a step, `handed`; returns how many are to the one before.
    int triangle(const TreeInput& in, LevelStep& step, int n, View& handed) {
        const int e = step.decided, d = step.d, own = step.own_end - step.own, w = padded(e + step.d_before);
        step.rows = n + own;
        most_rows_ = max(most_rows_, step.rows);
        work_.swap(other_work_);  // where rows on x were turned to is not where they are turned to now
        std::vector<double>& memory = work_;
        const size_t size = size_t(step.rows + d) * w + 2 * padded(d);
        memory.resize(max(memory.size(), size));
        double *rows = memory.data(), *both = rows + size_t(step.rows) * w, *x = both + size_t(d) * w, *unit = x + padded(d);
        join_flow(step, both, w, unit);
        for (int r = 0; r < step.rows; r++) {
            const double* given = handed.column(r);
            if (r >= n) {
                const int row = sorted[step.own + r - n];
                row_here(step, stages_->row(row), in.roots[row], x);
                given = x;
            }
            combine(given, both, w, d, rows + size_t(r) * w, w);
        }
        step.tape = tape_.take(0);
        for (int j = 0; j < e; j++) {
            const double pivot = abs(reflect_rows(rows, j, step.rows, w));
            strongest = max(strongest, pivot), weakest = min(weakest, pivot);
        }
        step.root = pool_.take(size_t(e) * w);
        copy(rows, pool_.at(step.root), size_t(e) * w);
        const int rest = step.rows - e;
        step.squeezed = rest > 2 * step.d_before ? min(rest, step.d_before) : 0;
        for (int j = 0; j < step.squeezed; j++) reflect_rows(rows, e + j, step.rows, w);
        for (int j = 0; j < step.squeezed; j++) clear(rows + size_t(e + j) * w + e, j);
        step.handed = rest > 2 * step.d_before ? step.squeezed : rest;
        handed = {rows + size_t(e) * w + e, w};
        return step.handed;
    }

    // both (d, w) := [M, F], what e, and x just before, do to x
    void join_flow(const LevelStep& step, double* both, int w, double* unit) const {
        const int e = step.decided;
        clear(both, size_t(step.d) * w);
        for (int j = 0; j < e; j++) {
            const double* moved = this->moved(step, j);
            for (int i = 0; i < step.d; i++) both[size_t(i) * w + j] = moved[i];
        }
        if (!step.d_before) return;
        clear(unit, step.d);
        for (int i = 0; i < step.d; i++) {
            unit[i] = 1.0;
            flow_back(*stages_, step, unit, both + size_t(i) * w + e);
            unit[i] = 0.0;
        }
    }

    // Turns rows (w) from `first` to `end` so that only the first has anything in the column of its number; returns what. What
    // is left of the others there is rounding: whoever looks at them does not look there, or clears it.
    double reflect_rows(double* rows, int first, int end, int w) {
        const int n = end - first;
        const size_t at = tape_.take(n + 1);
        double *tape = tape_.at(at), *v = tape + 1, *top = rows + size_t(first) * w, square = 0.0, other = 0.0;
        for (int i = 0; i < n; i++) {
            const double one = v[i] = top[size_t(i) * w + first];
            (i % 2 ? other : square) += one * one;
        }
        const double size = sqrt(square + other), head = v[0], beta = head >= 0.0 ? -size : size;
        const double tau = tape[0] = size == 0.0 ? 0.0 : (beta - head) / beta, scale = size == 0.0 ? 0.0 : 1.0 / (head - beta);
        for (int i = 1; i < n; i++) v[i] *= scale;
        v[0] = 1.0;
        if (size == 0.0) return 0.0;
        for (int k = aligned_start(first); k < w; k += WIDE) {
            double* to = top + k;
            Wide p = {}, q = {}, r = {}, s = {};
            int i = 0;
            for (; i + 4 <= n; i += 4) {
                p += wide_of(v[i]) * wide(to + size_t(i) * w), q += wide_of(v[i + 1]) * wide(to + size_t(i + 1) * w);
                r += wide_of(v[i + 2]) * wide(to + size_t(i + 2) * w), s += wide_of(v[i + 3]) * wide(to + size_t(i + 3) * w);
            }
            for (; i < n; i++) p += wide_of(v[i]) * wide(to + size_t(i) * w);
            p = ((p + r) + (q + s)) * wide_of(tau);
            for (i = 0; i < n; i++) wide(to + size_t(i) * w) -= wide_of(v[i]) * p;
        }
        return beta;
    }

    const Stages* stages_ = nullptr;
    int most_rows_ = 0;
    Pool tape_;
    std::vector<double> other_work_, turned_;
    Frame turn_;  // has no rows
    bool is_turned_ = false;
};

}  // namespace prioritized_ik
