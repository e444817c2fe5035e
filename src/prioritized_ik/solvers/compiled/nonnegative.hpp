// Least squares with coefficients that are not negative.
#pragma once

#include "dense.hpp"

namespace prioritized_ik {

// Whether all x >= 0 leave more than `most` where independent rows, with the triangle R, are balanced best by z: the lowest
// of z would have to change by its own size at least, times the distance of its row from what the others span.
inline bool leaves_more(const Triangle& R, const double* z, double most, Arena& arena) {
    Scope scope(arena);
    const int k = R.size, lowest = int(std::min_element(z, z + k) - z);
    double* inverse = arena.zeros(k);  // the lowest's row of R^-1, whose length is one over that distance
    inverse[lowest] = 1.0;
    R.solve_transposed(inverse);
    return -z[lowest] > most * norm(inverse, k);
}

// x >= 0 that makes |N^T x - target| least, N `t` rows of n, about unit length (Lawson and Hanson). All rows at once are
// tried first. Returns whether it ended; it does not where no x >= 0 leaves less than `most`, and that is plain to see: then x
// is that of all rows at once, of either sign.
inline bool nonnegative_least_squares(const double* rows, int stride, int t, int n, const double* target, double* x,
                                      double most, Arena& arena) {
    constexpr double LEFT_OUT = 1e-11, DEPENDENT = 1e-13, GAIN = 1e-14;
    Scope scope(arena);
    double *columns = arena.doubles(size_t(t + 1) * stride), *z = arena.doubles(t + 1), *rest = arena.doubles(stride);
    int *ids = arena.array<int>(t), *order = arena.array<int>(t + 1);
    char *inside = arena.array<char>(t), *barred = arena.array<char>(t);
    for (int i = 0; i < t; i++) inside[i] = 1;
    const double size = norm(target, n);

    // Least squares of the rows inside, in z by their places in ids; false if they are dependent.
    auto solve = [&](int& k) {
        k = 0;
        for (int i = 0; i < t; i++)
            if (inside[i]) {
                copy(rows + size_t(i) * stride, columns + size_t(k) * stride, stride);
                ids[k++] = i;
            }
        if (k > n) return false;
        double* side = columns + size_t(k) * stride;
        clear(side, stride);
        copy(target, side, n);
        column_qr(columns, stride, k + 1, k, n, order, false, arena);
        for (int j = 0; j < k; j++)
            if (!(abs(columns[size_t(j) * stride + j]) > DEPENDENT)) return false;
        copy(side, z, k);
        Triangle{columns, stride, k}.solve(z);
        return true;
    };
    auto positive = [&](int k) {
        for (int j = 0; j < k; j++)
            if (!(z[j] > 0.0)) return false;
        return true;
    };

    // All rows, those that depend on others left out.
    clear(x, t);
    copy(rows, columns, size_t(t) * stride);
    double* whole = columns + size_t(t) * stride;
    clear(whole, stride);
    copy(target, whole, n);
    column_qr(columns, stride, t + 1, t, n, order, true, arena);
    int k = min(t, n);
    while (k > 0 && abs(columns[size_t(k - 1) * stride + k - 1]) <= LEFT_OUT) k--;
    copy(whole, z, k);
    Triangle{columns, stride, k}.solve(z);
    if (positive(k)) {
        for (int j = 0; j < k; j++) x[order[j]] = z[j];
        return true;
    }
    if (k == t && leaves_more(Triangle{columns, stride, k}, z, most, arena)) {
        for (int j = 0; j < k; j++) x[order[j]] = z[j];
        return false;
    }
    // Then those of them that have a share, where that is a start; or else none.
    const double largest = *std::max_element(z, z + k);
    for (int i = 0; i < t; i++) inside[i] = barred[i] = 0;
    for (int j = 0; j < k; j++) inside[order[j]] = z[j] > LEFT_OUT * largest;
    if (solve(k) && positive(k)) {
        for (int j = 0; j < k; j++) x[ids[j]] = z[j];
    } else {
        std::memset(inside, 0, t);
    }
    for (int iteration = 0; iteration < 3 * t + 30; iteration++) {
        copy(target, rest, n);
        double terms = size;  // a gain that rounding of these can feign is none
        for (int i = 0; i < t; i++)
            if (x[i] != 0.0) {
                add(-x[i], rows + size_t(i) * stride, rest, n);
                terms += x[i];
            }
        int best = -1;
        double highest = GAIN * terms * sqrt(double(n));
        for (int i = 0; i < t; i++)
            if (!inside[i] && !barred[i]) {
                const double gain = dot(rows + size_t(i) * stride, rest, n);
                if (gain > highest) highest = gain, best = i;
            }
        if (best < 0) return true;
        inside[best] = 1;
        for (int inner = 0; inner < t + 5; inner++) {
            if (!solve(k)) {  // the others say what it says
                inside[best] = 0;
                barred[best] = 1;
                break;
            }
            if (positive(k)) {
                clear(x, t);
                for (int j = 0; j < k; j++) x[ids[j]] = z[j];
                if (inside[best]) std::memset(barred, 0, t);
                else barred[best] = 1;  // its gain was rounding
                break;
            }
            double part = 1.0;
            for (int j = 0; j < k; j++)
                if (z[j] <= 0.0) part = min(part, x[ids[j]] / (x[ids[j]] - z[j]));
            for (int j = 0; j < k; j++) {
                double& value = x[ids[j]];
                value += part * (z[j] - value);
                if (z[j] <= 0.0 && value <= GAIN * (size + abs(z[j]))) value = 0.0, inside[ids[j]] = 0;
            }
        }
    }
    return false;
}

}  // namespace prioritized_ik
