// Numbers of twice the digits of a double, as the unevaluated sum of two (Dekker 1971; Ogita, Rump and Oishi 2005).
//
// Products come from fma, never from a plain product: the compiler may contract that with the sum after it, which would take
// from the sum the rounding that is to be kept.
#pragma once

#include "dense.hpp"

namespace prioritized_ik {

struct DoubleDouble {
    double high = 0.0, low = 0.0;

    double rounded() const { return high + low; }
};

// high += a, the rounding to low
inline void add_exactly(double a, double& high, double& low) {
    const double sum = high + a, part = sum - high;
    low += (high - (sum - part)) + (a - part);
    high = sum;
}

inline void add_product(double a, double b, double& high, double& low) {
    const double product = std::fma(a, b, 0.0);
    low += std::fma(a, b, -product);
    add_exactly(product, high, low);
}

// high and low so that high is their sum rounded; of |low| << |high|
inline void normalize(double& high, double& low) {
    const double sum = high + low;
    low -= sum - high;
    high = sum;
}

inline DoubleDouble operator+(DoubleDouble a, DoubleDouble b) {
    a.low += b.low;
    add_exactly(b.high, a.high, a.low);
    normalize(a.high, a.low);
    return a;
}

inline DoubleDouble operator-(DoubleDouble a) { return {-a.high, -a.low}; }

inline DoubleDouble operator*(double factor, DoubleDouble a) {
    DoubleDouble product{0.0, factor * a.low};
    add_product(factor, a.high, product.high, product.low);
    normalize(product.high, product.low);
    return product;
}

// A row of such numbers.
struct Doubled {
    double *high, *low;

    DoubleDouble operator[](int i) const { return {high[i], low[i]}; }
    void set(int i, DoubleDouble value) const { high[i] = value.high, low[i] = value.low; }
    Doubled from(size_t i) const { return {high + i, low + i}; }
};

// n padded, beyond which rows are zero
inline DoubleDouble dot(const double* a, Doubled b, int n) {
    double high[LANES] = {}, low[LANES] = {};
    for (int i = 0; i < n; i += LANES)
        for (int k = 0; k < LANES; k++) {
            low[k] += a[i + k] * b.low[i + k];
            add_product(a[i + k], b.high[i + k], high[k], low[k]);
        }
    DoubleDouble sum;
    for (int k = 0; k < LANES; k++) sum = sum + DoubleDouble{high[k], low[k]};
    return sum;
}

inline DoubleDouble dot(Doubled a, Doubled b, int n) {
    double high[LANES] = {}, low[LANES] = {};
    for (int i = 0; i < n; i += LANES)
        for (int k = 0; k < LANES; k++) {
            low[k] += a.high[i + k] * b.low[i + k] + a.low[i + k] * b.high[i + k];
            add_product(a.high[i + k], b.high[i + k], high[k], low[k]);
        }
    DoubleDouble sum;
    for (int k = 0; k < LANES; k++) sum = sum + DoubleDouble{high[k], low[k]};
    return sum;
}

// to += factor * row
inline void add(DoubleDouble factor, const double* row, Doubled to, int n) {
    for (int i = 0; i < n; i++) {
        double high = to.high[i], low = to.low[i] + factor.low * row[i];
        add_product(factor.high, row[i], high, low);
        normalize(high, low);
        to.high[i] = high;
        to.low[i] = low;
    }
}

// to += factor * row, of such numbers
inline void add(DoubleDouble factor, Doubled row, Doubled to, int n) {
    for (int i = 0; i < n; i++) {
        double high = to.high[i], low = to.low[i] + (factor.low * row.high[i] + factor.high * row.low[i]);
        add_product(factor.high, row.high[i], high, low);
        normalize(high, low);
        to.high[i] = high;
        to.low[i] = low;
    }
}

}  // namespace prioritized_ik
