"""The solve and its certificate in C++: the form that is fast, beside the Python form that is read.

    library.py     finds, checks and loads what `hatch_build.py` compiled; says why there is none
    workspace.py   arrays that both sides see, filled from a problem
    fast.py        from a problem to the `JointStep` of the core, or to None where the core declines
    core.cpp       the core's interface, exchange.hpp, what it and Python say to each other
    step.hpp       the course of a call, on layers: posed.hpp (the problem in its metric), factored.hpp (one factorisation
                   for all levels), face.hpp (the step where some rows hold), extended.hpp (with more digits),
                   certificate.hpp, written.hpp, dual.hpp (a guess of the rows that hold), active_set.hpp
    packed.hpp     problems that are handed over as one array, see ../../packed.py
    posing.hpp     rows of robots written where they are, see ../../posing.py
    dense.hpp      the linear algebra beneath; with singular_values.hpp, nonnegative.hpp and double_double.hpp
    tree.hpp       the elimination along a kinematic tree, for tree.py, see solvers/tree; on tree_stages.hpp (its stages),
                   tree_frame.hpp (what a level decides) and tree_level.hpp (its triangle)
    tree_step.py   from a problem on a tree to its `JointStep`, or to why the core declines; tree_search.hpp, on
                   tree_problem.hpp (the problem in its metric) and tree_proof.hpp (the proof of a step)
    winding.hpp    a winding controller's look and the numbers of its problem, for winding/compiled.py

The core answers where every decision is clear: ranks on both sides of their cuts, rows that are tight or are not, a
certificate that holds with a margin. In every other case it declines and the Python form answers, with no loss but time.
What it proves means what `certificate.py` proves, from the rows as they are given; rounding excuses nothing. Where
rounding of doubles could hide whether a step is optimal, it looks with twice their digits, of which `certificate.py` has
fewer, and mends the step by what it lacks. A step that is optimal, but that rounding of the problem's own numbers leaves
undecided by far more than a certificate allows, is `UNCERTIFIED` in both forms, and the core's. Tolerances are those of
`tolerances.py`, handed over when the library is loaded.

What runs compiled, and what is left to the Python form:

| feature | compiled |
|---|---|
| `equal` levels, weights, any number | yes |
| bounds, frozen joints, inequality rows, equalities | yes |
| reference, metric (diagonal or matrix) | yes |
| levels of soft inequalities (`at_most`, `soften`) | yes |
| damping, `"free"` or `"hold"` | yes |
| rank tolerance | yes, unless a singular value stands at the cut |
| start from the last step's rows, or from any solver's guess | yes |
| `noise` above the default | no |
| equalities that nearly depend on each other, or are rounding | no |
| conflicts: which rows contradict each other | no |
| formulations `damped` and `slack`, `polish=False` | no |
"""
