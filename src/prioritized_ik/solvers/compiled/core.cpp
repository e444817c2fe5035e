// The C interface of the compiled step, as library.py loads it.
#include <new>

#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include "packed.hpp"
#include "posing.hpp"
#include "step.hpp"
#include "tree_search.hpp"
#include "winding.hpp"

#ifndef PRIORITIZED_IK_SOURCE
#error "compile with -DPRIORITIZED_IK_SOURCE='\"digest of the sources\"', as hatch_build.py does"
#endif

#define EXPORTED extern "C" __attribute__((visibility("default")))

using prioritized_ik::Sizes;
using prioritized_ik::Step;
using prioritized_ik::Tolerances;

EXPORTED const char* core_source() { return PRIORITIZED_IK_SOURCE; }

EXPORTED const char* core_tolerances() {
#define FIELD(name) #name " "
    return PRIORITIZED_IK_TOLERANCES(FIELD);
#undef FIELD
}

// The highest of x86-64's levels, 1, 3 or 4, that this processor and its system run well; 0 for another processor. Asked of
// the processor itself: not every compiler's runtime answers __builtin_cpu_supports from a shared library.
EXPORTED int core_x86_level() {
#if defined(__x86_64__)
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(0, &a, &b, &c, &d)) return 1;
    constexpr unsigned AMD = 0x444d4163, ZEN_4 = 0x19;  // end of the vendor's name, family
    const bool is_amd = c == AMD;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return 1;
    const unsigned family = (a >> 8 & 0xf) + (a >> 20 & 0xff);
    const bool halves = is_amd && family <= ZEN_4;  // registers of eight doubles, in two goes: slower than those of four
    const bool fma = c >> 12 & 1, saves = c >> 27 & 1, avx = c >> 28 & 1;
    if (!fma || !saves || !avx || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 1;
    const bool bmi = b >> 3 & 1, avx2 = b >> 5 & 1, bmi2 = b >> 8 & 1;
    constexpr unsigned REGISTERS = 0x6, WIDE_REGISTERS = 0xe6;  // that the system saves
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if (!bmi || !avx2 || !bmi2 || (low & REGISTERS) != REGISTERS) return 1;
    constexpr unsigned AVX512 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;  // F, DQ, CD, BW, VL
    return !halves && (b & AVX512) == AVX512 && (low & WIDE_REGISTERS) == WIDE_REGISTERS ? 4 : 3;
#else
    return 0;
#endif
}

EXPORTED Step* core_new(int joints, int levels, int level_rows, int rows, int equalities, const double* tolerances) {
    Tolerances values;
    std::memcpy(&values, tolerances, sizeof values);
    try {
        return new Step(Sizes{joints, levels, level_rows, rows, equalities}, values);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}

EXPORTED void core_delete(Step* step) { delete step; }

EXPORTED int core_stride(const Step* step) { return step->stride; }

// Addresses of the arrays of Exchange, in the order in which they stand there.
EXPORTED void core_arrays(Step* step, void** at) {
    auto& io = step->io;
    for (auto* array : {&io.matrix, &io.target, &io.weights, &io.damping, &io.lower, &io.upper, &io.row_matrix, &io.row_upper,
                        &io.equality_matrix, &io.equality_target, &io.metric_root, &io.reference, &io.settings})
        *at++ = array->data();
    *at++ = io.ends.data();
    *at++ = io.soft.data();
    *at++ = io.guess.data();
    *at++ = io.multipliers.data();
    *at++ = io.dtheta;
    *at++ = io.figures;
    *at++ = io.kept;
    *at++ = io.lists;
}

// Says how much there is of everything in the problems that come next.
EXPORTED void core_size(Step* step, int levels, int level_rows, int rows, int equalities) {
    step->size(Sizes{step->most.joints, levels, level_rows, rows, equalities});
}

// Whether the numbers of a problem, in one array, are beyond doubt.
EXPORTED int core_is_sound(const Step* step, const double* packed, double largest) {
    return prioritized_ik::is_sound(packed, step->io, step->now(), largest);
}

// An `Ending`, and above its eight bits how much of the lists is written; -1 if memory runs out. Of the problem that stands in
// Exchange, or with the numbers `packed`.
EXPORTED int core_solve(Step* step, int question, const double* packed) {
    try {
        if (packed) prioritized_ik::read_packed(packed, step->io, step->now(), step->stride);
        const int ending = step->solve(prioritized_ik::Question(question));
        return ending | step->io.used << 8;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

EXPORTED int core_scene_size() { return int(sizeof(prioritized_ik::Scene)); }

// A `Look::Answer` each.
EXPORTED int core_scene_observe(const prioritized_ik::Scene* scene) { return prioritized_ik::Look(*scene).observe(); }
EXPORTED int core_scene_pose(const prioritized_ik::Scene* scene, const prioritized_ik::Numbers* to) {
    return prioritized_ik::Look(*scene).pose(*to);
}

EXPORTED int core_posing_size() { return int(sizeof(prioritized_ik::Posing)); }
EXPORTED int core_posed_rows_size() { return int(sizeof(prioritized_ik::PosedRows)); }
EXPORTED void core_pose(const prioritized_ik::Posing* posing) { prioritized_ik::Poser(*posing).write(); }

// ---- Kinematic trees, for compiled/tree.py. Functions that may run out of memory return -1 then.

EXPORTED prioritized_ik::TreeSearch* core_tree_new(const double* tolerances) {
    Tolerances values;
    std::memcpy(&values, tolerances, sizeof values);
    return new (std::nothrow) prioritized_ik::TreeSearch(values);
}
EXPORTED void core_tree_delete(prioritized_ik::TreeSearch* tree) { delete tree; }

// An `Ending`, and above its eight bits how much of the lists is written.
EXPORTED int core_tree_step(prioritized_ik::TreeSearch* tree, const prioritized_ik::TreeProblem* problem) {
    try {
        return tree->step(*problem);
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

EXPORTED int core_tree_input_size() { return int(sizeof(prioritized_ik::TreeInput)); }

EXPORTED int core_tree_pose(prioritized_ik::TreeSearch* tree, const prioritized_ik::TreeInput* input) {
    try {
        tree->pose(*input);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

// `Factors.motions`.
EXPORTED int core_tree_motions(const prioritized_ik::TreeSearch* tree, const double* u, double* motions, double* sizes) {
    try {
        tree->motions(u, motions, sizes);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

// `Factors.damp` and `Factors.damped`, the first where u is null.
EXPORTED int core_tree_damped(prioritized_ik::TreeSearch* tree, const double* rows, const double* joints, double* u) {
    try {
        if (u) tree->damped(rows, joints, u);
        else tree->damp(rows, joints);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

// A `TreeElimination::Clarity`.
EXPORTED int core_tree_factor(prioritized_ik::TreeSearch* tree) {
    try {
        return tree->factor();
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

EXPORTED int core_tree_solve(prioritized_ik::TreeSearch* tree, const double* values, const double* sides,
                             const double* reference, double* u) {
    try {
        tree->solve(values, sides, reference, u);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

enum TreeQuestion { PARTS, WHITENED, PULLS, DISPLACEMENT, LEFT_BY };  // of compiled/tree.py

EXPORTED int core_tree_ask(prioritized_ik::TreeSearch* tree, int question, int level, const double* given, double* out) {
    try {
        if (question == PARTS) tree->parts(given, out);
        else if (question == WHITENED) tree->whitened(level, given, out);
        else if (question == PULLS) tree->pulls(level, given, out);
        else if (question == DISPLACEMENT) tree->displacement(level, given, out);
        else tree->left_by(level, given, out);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

// Writes `TreeElimination::Balance` to figures (6).
EXPORTED int core_tree_balance(prioritized_ik::TreeSearch* tree, int level, int is_held, double rounded, const double* given,
                               const double* sizes, double* off, double* rest, double* pulls, double* of_bounds, double* figures) {
    try {
        const auto found = tree->balance(level, given, sizes, rounded, is_held != 0, off, rest, pulls, of_bounds);
        std::memcpy(figures, &found, sizeof found);
        return 0;
    } catch (const std::bad_alloc&) {
        return -1;
    }
}

// -2 if memory runs out, as -1 is an answer.
EXPORTED int core_tree_count_below(prioritized_ik::TreeSearch* tree, int level, double tau) {
    try {
        return tree->count_below(level, tau);
    } catch (const std::bad_alloc&) {
        return -2;
    }
}

EXPORTED double core_tree_memory(const prioritized_ik::TreeSearch* tree) { return double(tree->memory()); }
