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
// metric) stands there already.
inline void read_packed(const double* from, Exchange& io, const Sizes& now, int stride) {
    const size_t m = now.joints;
    const auto next = [&](std::vector<double>& to, size_t n) {
        copy(from, to.data(), n);
        from += n;
    };
    const auto rows = [&](std::vector<double>& to, size_t n) {
        for (size_t i = 0; i < n; i++, from += m) copy(from, to.data() + i * stride, m);
    };
    rows(io.matrix, now.level_rows);
    next(io.target, now.level_rows);
    next(io.weights, now.level_rows);
    next(io.lower, m);
    next(io.upper, m);
    next(io.reference, m);
    rows(io.row_matrix, now.rows);
    next(io.row_upper, now.rows);
    rows(io.equality_matrix, now.equalities);
    next(io.equality_target, now.equalities);
}

// Whether IKProblem would take all of these numbers without a closer look: false leaves that to its checks.
inline bool is_sound(const double* from, const Exchange& io, const Sizes& now, double largest) {
    const size_t m = now.joints;
    bool sound = true;
    const auto finite = [&](size_t n) {
        sound &= all_within(from, n, largest);
        from += n;
    };
    const auto upper = [&](size_t n) {  // sides that may be infinite
        for (size_t i = 0; i < n; i++) sound &= from[i] >= -largest && (from[i] <= largest || from[i] == INFINITE);
        from += n;
    };
    const auto not_zero = [&](size_t n) {  // rows
        const auto counts = [](double x) { return x != 0.0; };
        for (size_t i = 0; i < n; i++) sound &= std::any_of(from + i * m, from + (i + 1) * m, counts);
    };
    finite(now.level_rows * m);
    for (int l = 0, first = 0; l < now.levels; first = io.ends[l++])
        if (const size_t n = io.ends[l] - first; io.soft[l]) upper(n);
        else finite(n);
    for (int i = 0; i < now.level_rows; i++) sound &= from[i] >= 0.0;
    finite(now.level_rows);
    const double *low = from, *high = from + m;
    for (size_t j = 0; j < m; j++)
        sound &= low[j] <= high[j] && low[j] <= largest && high[j] >= -largest && (low[j] >= -largest || low[j] == -INFINITE) &&
                 (high[j] <= largest || high[j] == INFINITE);
    from += 2 * m;
    finite(m);
    not_zero(now.rows);
    finite(now.rows * m);
    upper(now.rows);
    not_zero(now.equalities);
    finite(now.equalities * m);
    finite(now.equalities);
    return sound;
}

}  // namespace prioritized_ik
