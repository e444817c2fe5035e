"""From a problem to a certified joint step.

The map of one solve, in the order in which it runs:

    solve.solve                 the door: checks arguments, raises what went wrong
     ├ registry.get_method      a name such as active-set or damped:daqp becomes a Method (methods, daqp_hierarchy)
     └ Method.step              how it differs from others; lexicographic.joint_step is what all share: damped levels'
       │                        optima are handed down (damping), then
       ├ hierarchy.Hierarchy    the problem in its joint metric, without rounding; each level cut to its rank (Eq. 6,
       │                        level_decomposition) and whitened: an EqualBlock or a SoftBlock
       ├ .closed_form           Eqs. 12-14, level by level: the answer if it meets every row
       ├ a guess of active rows   of the last step (ActiveSet); of a QP solver, level by level (Lexicographic: fold,
       │                        stages, backends); or from nothing (stagewise)
       ├ active_set.solve       the kernel: the step on the guessed face, the ratio test, rows that pull, until
       └ certificate.Proof      proves it, sharing nothing with what found it
    conflict.find_conflict      where no step keeps all hard rows: the smallest set in conflict
    explain, report             which level gave way and to what; what was cut

The methods `lifted` make the guess in sparse QPs, link by link on a kinematic tree (`lifted`). `damped` and `slack`,
for comparison, are one QP (stages) in place of the fold, and `closed-form` is Eqs. 12-14
alone. Packages add families: `comparisons.methods` those of mink and of the reference in CVXPY.

Long arms go joint by joint (`tree`), where `joint_step` asks it first; most other problems through the core in C++
(`compiled`), which it asks next.

`blocks.py` holds what a hierarchy is made of, `subspaces.py` the geometry. A proof looks at each level (`looks.py`): rows
balance its gradient (`balance.py`) or do not (`level_proof.py`), in doubles or with twice their digits, in what the levels
above leave (`decided.py`). `prioritized_ik.tolerances` holds the thresholds, and `witness.py` is a
reference in CVXPY that shares no code with any of this.
"""
