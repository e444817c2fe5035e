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
        for (size_t k = steps.size(); k-- > 0;) n = triangle(in, steps[k], n);
    }

    // z -> e, f, of the frame before it was turned; see `Frame::split`.
    void split(const double* z, double* e, double* f) {
        if (is_turned_) {
            turned_.resize(inputs);
            turn_.split(z, nullptr, turned_.data());
            z = turned_.data();
        }
        Frame::split(z, e, f);
    }

    // e, f -> z, of the frame before it was turned; zero where null.
    void join(const double* e, const double* f, double* z) {
        if (!is_turned_) return Frame::join(e, f, z);
        turned_.resize(inputs);
        Frame::join(e, f, turned_.data());
        turn_.join(nullptr, turned_.data(), z);
    }

    // Q^T of right-hand sides (k).
    void from_sides(const double* sides, double* q) {
        double* y = buffer(most_rows_);
        int n = 0;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            for (int i = step.own; i < step.own_end; i++) y[n++] = sides[sorted[i]];
            const double* tape = tape_.data() + step.tape;
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
        double *y = buffer(most_rows_), *other = y + padded(most_rows_);
        for (const LevelStep& step : steps) {
            const int n = step.rows, e = step.decided;
            copy(whitened + step.e_at, other, e);
            copy(y, other + e, step.handed);
            clear(other + e + step.handed, n - e - step.handed);
            const int reflectors = e + step.squeezed;
            const double* tape = tape_.data() + step.tape + reflectors * (n + 1) - reflectors * (reflectors - 1) / 2;
            for (int j = reflectors - 1; j >= 0; j--) {
                tape -= n - j + 1;
                reflect_values(tape + 1, tape[0], other + j, n - j);
            }
            const int before = n - (step.own_end - step.own);
            for (int i = step.own; i < step.own_end; i++) out[sorted[i]] = other[before + i - step.own];
            std::swap(y, other);
        }
    }

    // e := R^-1 q
    void solve(const double* q, double* e) {
        double *t = buffer(most_), *next = t + most_;
        for (const LevelStep& step : steps) {
            const double* root = pool_.data() + step.root;
            const int width = padded(step.decided + step.d_before);
            double* own = e + step.e_at;
            for (int i = step.decided - 1; i >= 0; i--) {
                const double* row = root + size_t(i) * width;
                double value = q[step.e_at + i];
                for (int j = i + 1; j < step.decided; j++) value -= row[j] * own[j];
                for (int j = 0; j < step.d_before; j++) value -= row[step.decided + j] * t[j];
                own[i] = value / row[i];
            }
            flow(*stages_, step, t, next);
            const double* moved = pool_.data() + step.moved;
            const int stride = padded(step.decided);
            for (int i = 0; i < step.d; i++)
                for (int j = 0; j < step.decided; j++) next[i] += moved[size_t(i) * stride + j] * own[j];
            std::swap(t, next);
        }
    }

    // out := R^-T of a gradient
    void whiten(const double* gradient, double* out) {
        double *back = buffer(2 * most_), *next = back + most_, *felt = next + most_, *handed = felt + most_;
        for (size_t k = steps.size(); k-- > 0;) {
            const LevelStep& step = steps[k];
            const double *root = pool_.data() + step.root, *moved = pool_.data() + step.moved;
            const int e = step.decided, width = padded(e + step.d_before), stride = padded(e);
            double* own = out + step.e_at;
            combine(back, moved, stride, step.d, felt, stride);
            for (int j = 0; j < e; j++) {
                double value = gradient[step.e_at + j] - felt[j];
                for (int i = 0; i < j; i++) value -= root[size_t(i) * width + j] * own[i];
                own[j] = value / root[size_t(j) * width + j];
            }
            flow_back(*stages_, step, back, next);
            combine(own, root, width, e, handed, width);
            for (int j = 0; j < step.d_before; j++) next[j] += handed[e + j];
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
            unit.assign(size_t(max(step.d_before, 1)) + d, 0.0);
            for (int a = 0; a < d; a++)
                for (int b = 0; b < i; b++) both[size_t(a) * n + b] = input(step, a, b);
            for (int b = 0; b < step.d_before; b++) {
                unit.assign(size_t(step.d_before) + d, 0.0);
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

    size_t memory() const { return Frame::memory() + turn_.memory() + sizeof(double) * tape_.capacity(); }

  private:
    static void reflect_values(const double* v, double factor, double* y, int n) {
        double sum = 0.0;
        for (int i = 0; i < n; i++) sum += v[i] * y[i];
        sum *= factor;
        for (int i = 0; i < n; i++) y[i] -= sum * v[i];
    }

    // See `Triangle`: n rows are handed on to a step; returns how many are to the one before.
    int triangle(const TreeInput& in, LevelStep& step, int n) {
        const int e = step.decided, d = step.d, own = step.own_end - step.own, w = padded(e + step.d_before);
        step.rows = n + own;
        most_rows_ = max(most_rows_, step.rows);
        work_.assign(size_t(step.rows) * w + padded(d) + padded(step.d_before), 0.0);
        double *rows = work_.data(), *x = rows + size_t(step.rows) * w, *back = x + padded(d);
        const double* moved = pool_.data() + step.moved;
        for (int r = 0; r < step.rows; r++) {
            const double* given = handed_.data() + size_t(r) * padded(d);
            if (r >= n) {
                const int row = sorted[step.own + r - n];
                row_here(step, stages_->row(row), in.roots[row], x);
                given = x;
            }
            double* to = rows + size_t(r) * w;
            combine(given, moved, padded(e), d, to, padded(e));
            flow_back(*stages_, step, given, back);
            copy(back, to + e, step.d_before);
        }
        step.tape = tape_.size();
        for (int j = 0; j < e; j++) {
            const double pivot = abs(reflect_rows(rows, j, step.rows, j, w));
            strongest = max(strongest, pivot), weakest = min(weakest, pivot);
        }
        step.root = saved(rows, e, w, w);
        const int rest = step.rows - e;
        step.squeezed = rest > 2 * step.d_before ? min(rest, step.d_before) : 0;
        for (int j = 0; j < step.squeezed; j++) reflect_rows(rows, e + j, step.rows, e + j, w);
        step.handed = rest > 2 * step.d_before ? step.squeezed : rest;
        const int stride = padded(step.d_before);
        handed_.assign(size_t(step.handed) * stride, 0.0);
        for (int i = 0; i < step.handed; i++)
            copy(rows + size_t(e + i) * w + e, handed_.data() + size_t(i) * stride, step.d_before);
        return step.handed;
    }

    // Turns rows from `first` to `end` so that only the first has anything in a column; returns what.
    double reflect_rows(double* rows, int first, int end, int column, int w) {
        const int n = end - first, start = aligned_start(column);
        const size_t at = tape_.size();
        tape_.resize(at + n + 1);
        double* v = tape_.data() + at + 1;
        for (int i = 0; i < n; i++) v[i] = rows[size_t(first + i) * w + column];
        const double beta = reflector(v, v, n, tape_[at]), tau = tape_[at];
        for (int k = start; k < w; k += LANES) {
            Four sum = {};
            double* top = rows + size_t(first) * w + k;
            for (int i = 0; i < n; i++) sum += Four{v[i], v[i], v[i], v[i]} * four(top + size_t(i) * w);
            sum *= Four{tau, tau, tau, tau};
            for (int i = 0; i < n; i++) four(top + size_t(i) * w) -= Four{v[i], v[i], v[i], v[i]} * sum;
        }
        rows[size_t(first) * w + column] = beta;
        for (int i = 1; i < n; i++) rows[size_t(first + i) * w + column] = 0.0;
        return beta;
    }

    const Stages* stages_ = nullptr;
    int most_rows_ = 0;
    std::vector<double> tape_, handed_, turned_;
    Frame turn_;  // has no rows
    bool is_turned_ = false;
};

}  // namespace prioritized_ik
