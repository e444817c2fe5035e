// Dense linear algebra on rows that are padded with zeros: reflectors, LQ, QR, triangles.
// A "row" is `stride` doubles; only the first entries count, and the rest are zeros that vector instructions may read.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

namespace prioritized_ik {

using std::abs;
using std::max;
using std::min;
using std::sqrt;

constexpr double INFINITE = std::numeric_limits<double>::infinity();

// Four doubles at any address, and as many as one register of the processor holds.
typedef double Four __attribute__((vector_size(32), aligned(8)));
#if defined(__AVX512F__)
constexpr int LANES = 4, WIDE = 8;
typedef double Wide __attribute__((vector_size(64), aligned(8)));
inline Wide wide_of(double x) { return Wide{x, x, x, x, x, x, x, x}; }
inline Four folded(Wide x) { return __builtin_shufflevector(x, x, 0, 1, 2, 3) + __builtin_shufflevector(x, x, 4, 5, 6, 7); }
#else
constexpr int LANES = 4, WIDE = 4;
typedef Four Wide;
inline Wide wide_of(double x) { return Wide{x, x, x, x}; }
inline Four folded(Wide x) { return x; }
#endif

// Two doubles at any address: two of whatever is worked out, side by side.
typedef double Two __attribute__((vector_size(16), aligned(8)));

inline Four& four(double* at) { return *reinterpret_cast<Four*>(at); }
inline const Four& four(const double* at) { return *reinterpret_cast<const Four*>(at); }
inline Wide& wide(double* at) { return *reinterpret_cast<Wide*>(at); }
inline const Wide& wide(const double* at) { return *reinterpret_cast<const Wide*>(at); }
inline double total(Four x) { return (x[0] + x[2]) + (x[1] + x[3]); }

// The totals of four at once, in the same order of sums.
inline Four totals(Wide w, Wide x, Wide y, Wide z) {
    const Four p = folded(w), q = folded(x), r = folded(y), s = folded(z);
    const Four a = __builtin_shufflevector(p, q, 0, 1, 4, 5) + __builtin_shufflevector(p, q, 2, 3, 6, 7);
    const Four b = __builtin_shufflevector(r, s, 0, 1, 4, 5) + __builtin_shufflevector(r, s, 2, 3, 6, 7);
    return __builtin_shufflevector(a, b, 0, 2, 4, 6) + __builtin_shufflevector(a, b, 1, 3, 5, 7);
}

inline int padded(int n) { return (n + WIDE - 1) & ~(WIDE - 1); }
inline int aligned_start(int n) { return n & ~(WIDE - 1); }

inline double dot(const double* a, const double* b, int n) {
    Wide one = {}, two = {};
    int i = 0;
    for (; i + 2 * WIDE <= n; i += 2 * WIDE) {
        one += wide(a + i) * wide(b + i);
        two += wide(a + i + WIDE) * wide(b + i + WIDE);
    }
    if (i + WIDE <= n) {
        one += wide(a + i) * wide(b + i);
        i += WIDE;
    }
    Four rest = folded(one + two);
    if (WIDE > LANES && i + LANES <= n) {
        rest += four(a + i) * four(b + i);
        i += LANES;
    }
    double sum = total(rest);
    for (; i < n; i++) sum += a[i] * b[i];
    return sum;
}

inline double norm(const double* a, int n) { return sqrt(dot(a, a, n)); }

// to += factor * from
inline void add(double factor, const double* from, double* to, int n) {
    const Wide f = wide_of(factor);
    const Four g = {factor, factor, factor, factor};
    int i = 0;
    for (; i + WIDE <= n; i += WIDE) wide(to + i) += f * wide(from + i);
    if (WIDE > LANES && i + LANES <= n) {
        four(to + i) += g * four(from + i);
        i += LANES;
    }
    for (; i < n; i++) to[i] += factor * from[i];
}

// to[i] += |factor * from[i]|, n padded
inline void add_sizes(double factor, const double* from, double* to, int n) {
    const Wide f = wide_of(factor);
    for (int i = 0; i < n; i += WIDE) {
        const Wide x = f * wide(from + i);
        wide(to + i) += x > -x ? x : -x;
    }
}

// to += factors[0] * rows[0] + … of k rows, each `stride` after the other and zero where it is not to count; n is padded
inline void add_rows(const double* factors, const double* rows, int stride, int k, double* to, int n) {
    int j = 0;
    for (; j + 4 <= k; j += 4) {
        const double *a = rows + size_t(j) * stride, *b = a + stride, *c = b + stride, *d = c + stride;
        const Wide e = wide_of(factors[j]), f = wide_of(factors[j + 1]), g = wide_of(factors[j + 2]), h = wide_of(factors[j + 3]);
        for (int i = 0; i < n; i += WIDE) wide(to + i) += (e * wide(a + i) + f * wide(b + i)) + (g * wide(c + i) + h * wide(d + i));
    }
    for (; j < k; j++) add(factors[j], rows + size_t(j) * stride, to, n);
}

// The products of four rows with v, n padded.
inline Four products(const double* a, const double* b, const double* c, const double* d, const double* v, int n) {
    Wide p = {}, q = {}, r = {}, s = {};
    for (int j = 0; j < n; j += WIDE) {
        const Wide x = wide(v + j);
        p += wide(a + j) * x;
        q += wide(b + j) * x;
        r += wide(c + j) * x;
        s += wide(d + j) * x;
    }
    return totals(p, q, r, s);
}

// out := the products of k rows, each `stride` after the other, with b; n is padded
inline void dots(const double* rows, int stride, int k, const double* b, double* out, int n) {
    int i = 0;
    for (; i + 4 <= k; i += 4) {
        const double* p = rows + size_t(i) * stride;
        four(out + i) = products(p, p + stride, p + 2 * stride, p + 3 * stride, b, n);
    }
    for (; i < k; i++) out[i] = dot(rows + size_t(i) * stride, b, n);
}

// The least of n, infinite of none.
inline double least(const double* a, int n) {
    Wide low = wide_of(INFINITE);
    int i = 0;
    for (; i + WIDE <= n; i += WIDE) low = wide(a + i) < low ? wide(a + i) : low;
    double found = low[0];
    for (int k = 1; k < WIDE; k++) found = min(found, low[k]);
    for (; i < n; i++) found = min(found, a[i]);
    return found;
}

// to[i] += a[i]^2
inline void add_squares(const double* a, double* to, int n) {
    for (int i = 0; i < n; i++) to[i] += a[i] * a[i];
}

inline void clear(double* a, size_t n) { std::memset(a, 0, sizeof(double) * n); }
inline void copy(const double* from, double* to, size_t n) { std::memcpy(to, from, sizeof(double) * n); }

// Scratch memory, given back in the order in which it was taken. Runs out by an exception: the caller enlarges it.
class Arena {
  public:
    struct Exhausted {};

    explicit Arena(size_t size) { take(size + LINE); }

    double* doubles(size_t n) {
        n = (n + 7) & ~size_t(7);
        if (used_ + n + LINE > size_) throw Exhausted{};
        double* at = memory_.get() + offset() + used_;
        used_ += n;
        return at;
    }
    double* zeros(size_t n) {
        double* at = doubles(n);
        clear(at, n);
        return at;
    }
    template <class T> T* array(size_t n) {
        static_assert(sizeof(T) <= sizeof(double), "of at most eight bytes");
        return reinterpret_cast<T*>(doubles(n + 1));
    }
    void enlarge() { take(2 * size_); }
    size_t used() const { return used_; }
    void back_to(size_t used) { used_ = used; }

  private:
    static constexpr size_t LINE = 8;  // doubles of one line of the cache, at whose start all pieces begin
    size_t offset() const { return (LINE - reinterpret_cast<size_t>(memory_.get()) / sizeof(double) % LINE) % LINE; }

    void take(size_t size) {
        memory_.reset(new double[size]);  // not written to: pages that no solve needs are never touched; or the old ones stay
        size_ = size;
        used_ = 0;
    }

    std::unique_ptr<double[]> memory_;
    size_t size_ = 0, used_ = 0;
};

struct Scope {
    explicit Scope(Arena& arena) : arena_(arena), used_(arena.used()) {}
    ~Scope() { arena_.back_to(used_); }
    Scope(const Scope&) = delete;

  private:
    Arena& arena_;
    size_t used_;
};

// v and tau with (I - tau v v^T) x = beta e_0, v[0] = 1; v may be x. Returns beta.
inline double reflector(const double* x, double* v, int n, double& tau) {
    const double size = norm(x, n);
    if (size == 0.0) {
        for (int i = 0; i < n; i++) v[i] = 0.0;
        v[0] = 1.0;
        tau = 0.0;
        return 0.0;
    }
    const double beta = x[0] >= 0.0 ? -size : size, head = x[0], scale = 1.0 / (head - beta);
    tau = (beta - head) / beta;
    for (int i = 1; i < n; i++) v[i] = x[i] * scale;
    v[0] = 1.0;
    return beta;
}

// row := row (I - tau v v^T), n padded; `more` is what row v has elsewhere. Returns the factor of v.
inline double reflect(double* row, const double* v, double tau, int n, double more = 0.0) {
    Wide sum = {};
    for (int i = 0; i < n; i += WIDE) sum += wide(row + i) * wide(v + i);
    const double factor = -tau * (total(folded(sum)) + more);
    const Wide f = wide_of(factor);
    for (int i = 0; i < n; i += WIDE) wide(row + i) += f * wide(v + i);
    return factor;
}

// The same for all of `count` rows, four at a time; with HEAD, v is 1 at `head` of the rows too, besides from `from` on.
template <bool HEAD = false>
inline void reflect_all(double* const* rows, int count, int from, const double* v, double tau, int n, int head = 0) {
    int i = 0;
    for (; i + 4 <= count; i += 4) {
        double *a = rows[i] + from, *b = rows[i + 1] + from, *c = rows[i + 2] + from, *d = rows[i + 3] + from;
        double *e = rows[i] + head, *f = rows[i + 1] + head, *g = rows[i + 2] + head, *h = rows[i + 3] + head;
        Four sums = products(a, b, c, d, v, n);
        if (HEAD) sums += Four{*e, *f, *g, *h};
        const Four factors = sums * -tau;
        const Wide p = wide_of(factors[0]), q = wide_of(factors[1]), r = wide_of(factors[2]), s = wide_of(factors[3]);
        for (int j = 0; j < n; j += WIDE) {
            const Wide x = wide(v + j);
            wide(a + j) += p * x;
            wide(b + j) += q * x;
            wide(c + j) += r * x;
            wide(d + j) += s * x;
        }
        if (HEAD) *e += factors[0], *f += factors[1], *g += factors[2], *h += factors[3];
    }
    for (; i < count; i++) {
        const double factor = reflect(rows[i] + from, v, tau, n, HEAD ? rows[i][head] : 0.0);
        if (HEAD) rows[i][head] += factor;
    }
}

// A chain of reflectors, each a zero-padded row of `stride`.
class Reflectors {
  public:
    int count = 0;

    void reset(double* memory, int most, int stride) {
        memory_ = memory;
        stride_ = stride;
        count = 0;
        tau_.resize(most);
        first_.resize(most);
    }
    // Returns the zeroed row that is to hold the next reflector, which begins at `first`.
    double* next(int first) {
        double* row = memory_ + size_t(count) * stride_;
        clear(row, stride_);
        first_[count] = first;
        return row;
    }
    void keep(double tau) { tau_[count++] = tau; }

    // row := row H_0 H_1 ... of each of k rows
    void apply(double* const* rows, int k) const {
        for (int h = 0; h < count; h++) {
            const int from = aligned_start(first_[h]);
            reflect_all(rows, k, from, memory_ + size_t(h) * stride_ + from, tau_[h], stride_ - from);
        }
    }
    // row := H_0 H_1 ... row
    void apply_reversed(double* row) const {
        for (int h = count - 1; h >= 0; h--) one(row, h);
    }

  private:
    void one(double* row, int h) const {
        const int from = aligned_start(first_[h]);
        reflect(row + from, memory_ + size_t(h) * stride_ + from, tau_[h], stride_ - from);
    }

    double* memory_ = nullptr;
    int stride_ = 0;
    std::vector<double> tau_;
    std::vector<int> first_;
};

// Squared lengths of rows that shrink as coordinates are taken off them.
class ShrinkingNorms {
  public:
    ShrinkingNorms(int n, Arena& arena) : now_(arena.doubles(n)), exact_(arena.doubles(n)) {}
    void set(int i, double value) { now_[i] = exact_[i] = value; }
    void swap(int i, int j) {
        std::swap(now_[i], now_[j]);
        std::swap(exact_[i], exact_[j]);
    }
    int longest(int from, int to) const {
        int best = from;
        for (int i = from + 1; i < to; i++)
            if (now_[i] > now_[best]) best = i;
        return best;
    }
    // Takes off `part`; counts anew, from `rest`, when too few digits are left.
    void shrink(int i, double part, const double* rest, int n) {
        if (shrinks_too_far(i, part)) set(i, dot(rest, rest, n));
    }
    // Takes off `part`; whether too few digits are left, and the length is to be counted anew.
    bool shrinks_too_far(int i, double part) {
        now_[i] -= part * part;
        return now_[i] < LOST * exact_[i];
    }

  private:
    static constexpr double LOST = 1e-4;  // eight of sixteen digits are left
    double *now_, *exact_;
};

// LQ of rows[0 … n) in coordinates [c, m), the longest left first; rows[n … all) follow. Stops where what is left of every
// row is at most `stop`, and returns the rank; `left` is the Frobenius norm of what is left.
inline int row_pivoted_lq(double** rows, int* ids, int n, int all, int c, int m, int stride, Reflectors& chain, double stop,
                          double& left, Arena& arena) {
    Scope scope(arena);
    ShrinkingNorms norms(n, arena);
    for (int i = 0; i < n; i++) norms.set(i, dot(rows[i] + c, rows[i] + c, m - c));
    const int most = min(n, m - c);
    int r = 0;
    left = 0.0;
    for (; r < most; r++) {
        const int best = norms.longest(r, n), at = c + r, from = aligned_start(at);
        if (!(norm(rows[best] + at, m - at) > stop)) break;
        std::swap(rows[r], rows[best]);
        std::swap(ids[r], ids[best]);
        norms.swap(r, best);
        double *x = rows[r], *v = chain.next(at), tau;
        x[at] = reflector(x + at, v + at, m - at, tau);
        clear(x + at + 1, m - at - 1);
        chain.keep(tau);
        reflect_all(rows + r + 1, all - r - 1, from, v + from, tau, stride - from);
        for (int i = r + 1; i < n; i++) norms.shrink(i, rows[i][at], rows[i] + at + 1, m - at - 1);
    }
    double sum = 0.0;
    for (int i = r; i < n; i++) sum += dot(rows[i] + c + r, rows[i] + c + r, m - c - r);
    left = sqrt(sum);
    return r;
}

// QR of the first r of k columns of length n, stored as rows of `stride`; all k are transformed. With `kept`, reflector j is
// stored in its row j, and its factor in `taus`. The first `top` entries of all columns stay what they are.
inline void column_qr(double* columns, int stride, int k, int r, int n, int* order, bool pivot, Arena& arena,
                      double* kept = nullptr, double* taus = nullptr, int top = 0) {
    Scope scope(arena);
    ShrinkingNorms norms(r, arena);
    double** column = arena.array<double*>(k);
    double* own = arena.zeros(stride);
    for (int j = 0; j < k; j++) column[j] = columns + size_t(j) * stride;
    for (int j = 0; j < r; j++) {
        order[j] = j;
        if (pivot) norms.set(j, dot(column[j] + top, column[j] + top, n - top));
    }
    for (int j = 0; j < min(r, n - top); j++) {
        if (pivot) {
            const int best = norms.longest(j, r);
            if (best != j) {
                std::swap_ranges(column[j], column[j] + n, column[best]);
                std::swap(order[j], order[best]);
                norms.swap(j, best);
            }
        }
        const int at = top + j;
        double* v = kept ? kept + size_t(j) * stride : own;
        if (kept) clear(v, stride);
        else if (j) v[at - 1] = 0.0;
        double *x = column[j], tau;
        x[at] = reflector(x + at, v + at, n - at, tau);
        clear(x + at + 1, n - at - 1);
        if (taus) taus[j] = tau;
        const int from = aligned_start(at);
        reflect_all(column + j + 1, k - j - 1, from, v + from, tau, stride - from);
        if (pivot)
            for (int i = j + 1; i < r; i++) norms.shrink(i, column[i][at], column[i] + at + 1, n - at - 1);
    }
}

// QR of r columns, an upper triangle above n - r full rows; all k are transformed, as by column_qr, and reflectors are stored.
inline void triangle_qr(double* columns, int stride, int k, int r, int n, Arena& arena, double* kept, double* taus) {
    Scope scope(arena);
    double **column = arena.array<double*>(k), *tail = arena.zeros(stride);
    for (int j = 0; j < k; j++) column[j] = columns + size_t(j) * stride;
    const int from = aligned_start(r), m = n - r;
    for (int j = 0; j < r; j++) {
        double *x = column[j], *v = kept + size_t(j) * stride;
        clear(v, stride);
        const double head = x[j], size = sqrt(head * head + dot(x + r, x + r, m)), beta = head >= 0.0 ? -size : size;
        v[j] = 1.0;
        taus[j] = 0.0;
        if (size == 0.0) continue;
        const double scale = 1.0 / (head - beta);
        taus[j] = (beta - head) / beta;
        for (int i = r; i < n; i++) v[i] = tail[i] = x[i] * scale;
        x[j] = beta;
        clear(x + r, m);
        reflect_all<true>(column + j + 1, k - j - 1, from, tail + from, taus[j], stride - from, j);
    }
}

// An upper triangle R, its columns stored as rows of `stride`.
struct Triangle {
    double* columns;
    int stride, size;

    double* column(int j) const { return columns + size_t(j) * stride; }
    double diagonal(int j) const { return columns[size_t(j) * stride + j]; }

    // b := R^-1 b
    void solve(double* b) const { solve_leading(b, size); }
    void solve_leading(double* b, int n) const {
        for (int j = n - 1; j >= 0; j--) {
            b[j] /= diagonal(j);
            add(-b[j], column(j), b, j);
        }
    }
    // b := R^-T b
    void solve_transposed(double* b) const { solve_transposed(b, 0, 1); }
    // The same for `count` rows, each `apart` after the other: side by side, as each entry waits for those before it.
    void solve_transposed(double* rows, int apart, int count) const {
        for (int j = 0; j < size; j++)
            for (int i = 0; i < count; i++) {
                double* b = rows + size_t(i) * apart;
                b[j] = (b[j] - dot(column(j), b, j)) / diagonal(j);
            }
    }
    // out (zeros before) := R b
    void times(const double* b, double* out) const {
        for (int j = 0; j < size; j++) add(b[j], column(j), out, j + 1);
    }
    // Columns of R^-1 into rows of `stride`: of each, minus the columns before it weighed by R's column, over its diagonal.
    void invert(double* inverse) const {
        for (int j = 0; j < size; j++) {
            double* x = inverse + size_t(j) * stride;
            clear(x, stride);
            add_rows(column(j), inverse, stride, j, x, padded(j));
            const double scale = 1.0 / diagonal(j);
            for (int i = 0; i < j; i++) x[i] *= -scale;
            x[j] = scale;
        }
    }
};

}  // namespace prioritized_ik
