// Problems whose numbers stand in one array, rows without padding: packed.py says in which order.
#pragma once

#include "exchange.hpp"

namespace prioritized_ik {

// Not of those that are not numbers.
inline bool all_within(const double* a, size_t n, double largest) {
    const Wide high = wide_of(largest), low = wide_of(-largest);
    auto within = low <= high;
    size_t i = 0;
    for (; i + WIDE <= n; i += WIDE) within &= (wide(a + i) >= low) & (wide(a + i) <= high);
    bool all = true;
    for (int k = 0; k < WIDE; k++) all &= within[k] != 0;
    for (; i < n; i++) all &= abs(a[i]) <= largest;
    return all;
}

// Copies the numbers of a problem to where the solve reads them; what does not change (kinds and ends of levels, damping,
// metric) stands there already. Whether IKProblem would take all of it without a closer look: false leaves that to its checks.
inline bool read_packed(Exchange& io, const Sizes& now, int stride, double largest) {
    const size_t m = now.joints;
    const double* from = io.packed.data();
    bool sound = true;
    const auto next = [&](double* to, size_t n) {
        copy(from, to, n);
        from += n;
    };
    const auto finite = [&](double* to, size_t n) {
        sound &= all_within(from, n, largest);
        next(to, n);
    };
    const auto upper = [&](double* to, size_t n) {  // sides that may be infinite
        for (size_t i = 0; i < n; i++) sound &= from[i] >= -largest && (from[i] <= largest || from[i] == INFINITE);
        next(to, n);
    };
    const auto rows = [&](double* to, size_t n) {
        sound &= all_within(from, n * m, largest);
        for (size_t i = 0; i < n; i++) next(to + i * stride, m);
    };
    const auto rows_of_any_length = [&](double* to, size_t n) {  // not zero
        const auto counts = [](double x) { return x != 0.0; };
        for (size_t i = 0; i < n; i++) sound &= std::any_of(from + i * m, from + (i + 1) * m, counts);
        rows(to, n);
    };
    rows(io.matrix.data(), now.level_rows);
    for (int l = 0, first = 0; l < now.levels; first = io.ends[l++])
        if (const size_t n = io.ends[l] - first; io.soft[l]) upper(io.target.data() + first, n);
        else finite(io.target.data() + first, n);
    for (int i = 0; i < now.level_rows; i++) sound &= from[i] >= 0.0;
    finite(io.weights.data(), now.level_rows);
    const double *low = from, *high = from + m;
    for (size_t j = 0; j < m; j++)
        sound &= low[j] <= high[j] && low[j] <= largest && high[j] >= -largest && (low[j] >= -largest || low[j] == -INFINITE) &&
                 (high[j] <= largest || high[j] == INFINITE);
    next(io.lower.data(), m);
    next(io.upper.data(), m);
    finite(io.reference.data(), m);
    rows_of_any_length(io.row_matrix.data(), now.rows);
    upper(io.row_upper.data(), now.rows);
    rows_of_any_length(io.equality_matrix.data(), now.equalities);
    finite(io.equality_target.data(), now.equalities);
    return sound;
}

}  // namespace prioritized_ik
