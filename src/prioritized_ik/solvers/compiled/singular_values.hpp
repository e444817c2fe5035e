// Singular values of triangles and of rows, as near as is asked.
#pragma once

#include "dense.hpp"

namespace prioritized_ik {

// The smallest singular value of a triangle, by inverse iteration; -1 if it does not settle. If it is below `cut`, x is its
// right vector, or one of those of all singular values below the cut where several are.
inline double smallest_singular(const Triangle& R, double cut, double* x, Arena& arena) {
    constexpr int ITERATIONS = 60;
    constexpr double SETTLED = 4e-15, GOOD = 1e-13, NONE = 1e-18, CLEAR = 1.01, STEADY = 1e-5;
    Scope scope(arena);
    const int r = R.size;
    double *y = arena.doubles(r), largest = 0.0;
    for (int j = 0; j < r; j++) largest = max(largest, abs(R.diagonal(j)));
    for (int j = 0; j < r; j++)
        if (!(abs(R.diagonal(j)) > 1e-280 * largest)) return -1.0;
    clear(x, r);
    x[r - 1] = 1.0;
    double change_before = INFINITE, value_before = INFINITE;
    for (int iteration = 1; iteration <= ITERATIONS; iteration++) {
        copy(x, y, r);
        R.solve_transposed(y);
        const double once = norm(y, r);
        for (int j = 0; j < r; j++) y[j] /= once;
        R.solve(y);
        const double twice = norm(y, r), turn = (dot(x, y, r) > 0.0 ? 1.0 : -1.0) / twice, value = 1.0 / twice;
        double change = 0.0;
        for (int j = 0; j < r; j++) {
            y[j] *= turn;
            change = max(change, abs(y[j] - x[j]));
            x[j] = y[j];
        }
        if (iteration > 1 && (change < SETTLED || (change < GOOD && change >= change_before))) return value;
        // What x holds of the vectors above the cut shrinks by (value / cut)^2 in each iteration.
        if (value < cut && 2.0 * iteration * std::log(value / cut) < std::log(NONE)) return value;
        if (value > CLEAR * cut && iteration > 3 && abs(value - value_before) <= STEADY * value) return value;
        change_before = change;
        value_before = value;
    }
    return -1.0;
}

// The largest singular value of the linear map given by rows, by power iteration, from below: as near as is needed to tell on
// which side of `compared` it is; -1 if it does not settle.
inline double largest_singular(const double* const* rows, int n, int m, int stride, double compared, Arena& arena) {
    constexpr int ITERATIONS = 200;
    constexpr double SETTLED = 1e-10, CLEAR = 0.01;
    Scope scope(arena);
    double *x = arena.zeros(stride), *y = arena.doubles(stride), before = 0.0;
    for (int j = 0; j < m; j++) x[j] = (1.0 + 0.01 * (j % 7)) / (1.1 * sqrt(double(m)));  // shorter than one
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        clear(y, stride);
        for (int i = 0; i < n; i++) add(dot(rows[i], x, stride), rows[i], y, stride);
        const double size = norm(y, m);
        if (size == 0.0) return 0.0;
        for (int j = 0; j < m; j++) x[j] = y[j] / size;
        const double value = sqrt(size), change = value - before, apart = (compared - value) / value;
        // Slow progress towards the largest value, or towards a second one that is hardly smaller, is no longer than its root.
        if (apart < -SETTLED || abs(change) <= value * max(SETTLED, apart > 0.0 ? CLEAR * apart * apart : 0.0)) return value;
        before = value;
    }
    return -1.0;
}

}  // namespace prioritized_ik
