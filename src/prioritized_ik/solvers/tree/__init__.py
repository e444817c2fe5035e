"""Problems on a kinematic tree, solved and proven joint by joint: as long as there are joints, not as their cube.

    posed.py         a problem's levels and rows of points, in its joint metric
    stages.py        the tree as one chain of stages
    frames.py        what a level decides of the directions left to it, and what it leaves, orthonormal
    triangle.py      the level's rows in the former
    elimination.py   the strict levels of one face by these; the form to read, and what the compiled one is held to
                     (`compiled/tree.hpp`)
    factors.py       what such a factorisation is asked for
    balance.py       how far levels above, bounds and rows balance a level's gradient
    certificate.py   the proof of a step, from products with J and Jᵀ
    fine_rows.py     these with twice the digits, where gradients nearly cancel
    active_set.py    from a guess of the active rows to those of the optimum
    damped.py        least squares of rows and joints together, by one sweep
    interior.py      a guess by an interior point, made of these
    step.py          from a problem to its step, or to None where the dense form is to answer

Closed forms, and steps that a few corrections of the last one's rows come to, are found and proven in the compiled core in
one go (`compiled/tree_search.hpp`), to the same bits; what asks for an interior point, for one row after the other or for
more digits goes on here, by the core's factors.

What is answered, and what is left to the dense form:

| feature | along the tree |
|---|---|
| `equal` levels of points (`TreeLevel`), weights, any number | yes |
| bounds, frozen joints, inequality rows of points (`TreeRows`) | yes |
| reference, diagonal metric | yes |
| hinges, slides, balls, free bases; branches | yes |
| start from the last step's rows | yes |
| levels or rows of a matrix among them, damping, soft inequalities, equalities | no |
| a metric that couples joints, `noise` above the default | no |
| a rank tolerance that cuts zeros alone (what is between is counted, in linear time) | yes |
| a rank tolerance that cuts more | no |
| arms and limbs that are straight or nearly so | yes, unless limits hold a level by less than about 1e-11 of its gradient |
| rows in conflict, or a certificate without margin | no |
"""
