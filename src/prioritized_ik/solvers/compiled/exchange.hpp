// What the core and Python say to each other: tolerances, endings, and arrays that both see.
#pragma once

#include <cstdint>

#include "dense.hpp"

namespace prioritized_ik {

// Every number stands in tolerances.py, under the same name. FIELD(name)
#define PRIORITIZED_IK_TOLERANCES(FIELD)                                                                                    \
    FIELD(EPS) FIELD(NOISE) FIELD(DEPENDENT) FIELD(SETTLED_PER_RANK_TOLERANCE) FIELD(PROJECTION) FIELD(CERTIFIED) FIELD(GAP) \
    FIELD(UNDECIDED) FIELD(ROUNDING) FIELD(UNFELT) FIELD(NOTHING) FIELD(LEAST_DEMAND) FIELD(OFF) FIELD(KEPT) FIELD(DRIFT)    \
    FIELD(FREE) FIELD(FLOOR) FIELD(ITERATIONS) FIELD(ACCEPTED_VIOLATION) FIELD(MARGIN) FIELD(WEAKEST) FIELD(NEARLY)          \
    FIELD(CUT_MARGIN) FIELD(EMPTY) FIELD(REFINEMENTS) FIELD(CLOSE_MARGIN) FIELD(ROWS_PER_SEARCH) FIELD(PLAINLY) \
    FIELD(TREE_ZERO)

struct Tolerances {
#define FIELD(name) double name;
    PRIORITIZED_IK_TOLERANCES(FIELD)
#undef FIELD
};

// How a call ended; the names are those of `Ending` in library.py.
enum Ending : int {
    CLOSED_FORM,   // no row binds
    SOLVED,        // rows bind
    BINDING,       // the closed form breaks a row, and no more was asked for
    OPEN,          // optimal at every level, but rounding leaves it undecided, by far more than a certificate allows
    ROUNDING_ROW,  // declined: a row is so short that it may be rounding, or is and cannot be kept
    RANK,          // declined: a level's rank is not clear
    EQUALITIES,    // declined: equalities nearly depend on each other
    NEARLY_DECIDED,  // declined: the levels above nearly decide a row that binds
    NEARLY_TIGHT,  // declined: a row is nearly tight
    UNSETTLED,     // declined: the active rows do not come to rest
    UNPROVEN,      // declined: the certificate does not hold, or without margin
};

enum Guess : uint8_t { LOOSE, TIGHT_ROW, NOT_KEPT };  // of a row; those of fast.py

enum Question { STEP, CLOSED_FORM_ONLY, FROM_GUESS_ONLY, CLOSED_FORM_FIRST };  // those of library.py

struct Declined {
    Ending why;
};

// How much there is of everything, at most or now.
struct Sizes {
    int joints, levels, level_rows, rows, equalities;
};

enum Count { CORRECTIONS, FACES, PROOFS, ACTIVE, EXCEEDED, TIGHT, ZERO, HOLDING, COUNTS };  // the first of the lists
enum Figure { LEVEL_GAP, RELATIVE_GAP, STATIONARITY, ROUNDING, FIGURES };           // of a level

// What the caller writes and reads; arrays of rows have `stride` doubles a row, zeros beyond the joints.
struct Exchange {
    // in
    std::vector<double> matrix, target, weights, damping;  // of the levels, one after the other
    std::vector<double> lower, upper, row_matrix, row_upper, equality_matrix, equality_target, metric_root, reference;
    // Rank tolerance, noise, whether rows were rounded by the root of a metric, whether the guess is of a problem of another kind.
    std::vector<double> settings;
    std::vector<int32_t> ends;     // of the levels' rows
    std::vector<uint8_t> soft;     // whether a level is one of soft inequalities
    std::vector<uint8_t> guess;    // upper bounds, lower bounds, rows, rows of soft levels: a `Guess` each
    // out
    std::vector<double> multipliers;  // in the order of the list that names them
    std::vector<double> answer;       // what follows, one after the other
    double *dtheta, *figures;         // of a level: gap, relative gap, stationarity, rounding; then violation, scale, costs
    uint8_t* kept;                    // the rows that the step was computed from, as a guess for the next
    // First counts: corrections, faces, proofs, and the lengths of the lists that follow. Numbers of the rows that the step was
    // computed from, tight or exceeded, and of the hard rows it ends on; of rows that are rounding, the levels' first; of the
    // rows that hold a level, each after its level's number. Upper bounds come first, then lower bounds, rows, soft levels.
    int32_t* lists;
    int used = 0;  // of the lists

    Exchange(const Exchange&) = delete;
    Exchange(const Sizes& most, size_t stride) {
        const size_t m = most.joints, all = 2 * m + most.rows + most.level_rows, levels = most.levels;
        matrix.resize(most.level_rows * stride);
        for (auto* array : {&target, &weights}) array->resize(most.level_rows);
        damping.resize(levels);
        for (auto* array : {&lower, &upper, &metric_root, &reference}) array->resize(m);
        row_matrix.resize(most.rows * stride);
        row_upper.resize(most.rows);
        equality_matrix.resize(most.equalities * stride);
        equality_target.resize(most.equalities);
        settings.resize(4);
        ends.resize(levels);
        soft.resize(levels);
        guess.resize(all);
        multipliers.resize((levels + 1) * all);
        const size_t told = FIGURES * (levels + 1) + 2 + levels, guessed = all / sizeof(double) + 1;
        const size_t listed = COUNTS + 2 * all + most.level_rows + most.rows + 2 * (levels + 1) * all;
        answer.resize(stride + told + guessed + listed * sizeof(int32_t) / sizeof(double) + 1);
        dtheta = answer.data();
        figures = dtheta + stride;
        kept = reinterpret_cast<uint8_t*>(figures + told);
        lists = reinterpret_cast<int32_t*>(figures + told + guessed);
    }
};

}  // namespace prioritized_ik
