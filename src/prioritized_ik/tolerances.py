"""Every tolerance of the solve in one table: its unit, why this number, and what it separates.

Lengths are measured in the problem's joint metric, so that none of them depends on the units of joints or rows. "Of the
step" means relative to `Hierarchy.scale`; "of the row" means relative to the row's own length.
"""

import numpy as np

EPS = float(np.finfo(float).eps)

# --- What is rounding in the data ---------------------------------------------------------------------------------------

#: [–] What is this fraction of its surroundings is zero, unless a problem states the noise of its data. Jacobians of chains
#: of up to fifty joints carry 1e-16 to 1e-14; what is meant is rarely below 1e-9.
NOISE = 1e-12

#: [–] Rows of unit length that differ by less than this angle say the same. Dividing by it leaves five digits.
DEPENDENT = 1e-11

#: [–] How much of a row must be left by the levels above, as a fraction of the rank tolerance, to count as a row. With the
#: windings' 1e-4 that is 1e-9: along them the fraction takes every value. At 3e-7 a level's loss had no bound; at rounding
#: one step in ten is decided by it.
SETTLED_PER_RANK_TOLERANCE = 1e-5

#: [–] Rounding of a projection, in units of `EPS`, for up to a hundred joints.
PROJECTION = 16.0

# --- What a certificate allows ------------------------------------------------------------------------------------------

#: [of the step] Violation of a hard row, and displacement that would still lower a level's cost.
CERTIFIED = 1e-8

#: [of the level's demand, squared] How much lower a level's cost could be. The gap is a product of multiplier and slack, so
#: rounding alone leaves 1e-15 of the multipliers' share; a step that misses 1e-5 of what a level asks for has 1e-10.
GAP = 1e-9

#: [of the step] How far rounding may move the step where the certificate holds.
UNDECIDED = 1e-4

#: [–] The conditions are differences of large terms where a level wants far more than the rows allow; this fraction of the
#: terms is noise: sixty products of two doubles each.
ROUNDING = 64 * EPS

#: [–] A direction without cost counts as felt this much weaker than the level's strongest, so that descents along it show.
UNFELT = 1e-2

#: [–] A multiplier below this fraction of a level's terms is none.
NOTHING = 1e-12

# --- The active set -----------------------------------------------------------------------------------------------------

#: [of the step] A row nearer than this to a solver's answer is guessed to be active.
GUESS = 1e-6

#: [of the step] A row exceeded by less than this is kept: rounding.
KEPT = 1e-10

#: [of the step] What a row moves by directions too weak to count that is rounding.
DRIFT = 1e-14

#: [of the step] A closed-form step that breaks no row by more than this, its own rounding, breaks none.
FREE = 1e-12

#: [–] A step this fraction of what the levels ask for counts as this long, so that zero steps have a scale.
FLOOR = 1e-9

#: [–] Active rows visited before the search from a guess is given up.
ITERATIONS = 60

# --- Backends -----------------------------------------------------------------------------------------------------------

#: [of the step] A solver's own step may break a row by this much; beyond, it is not accepted.
ACCEPTED_VIOLATION = 1e-6

#: [of the step] A row this close to a stage's answer is tight: ten times what a solver at accuracy 1e-8 leaves open.
TIGHT = 1e-7

#: [–] The same fraction in the QPs that a solver gets: what it is divided by makes rounding of 1e-16 a constraint off by
#: 1e-9. A solver makes a guess, which the kernel corrects.
SETTLED_FOR_SOLVERS = 2e-6

#: [–] Tight rows that leave a wedge narrower than this leave no room to a QP solver: all fail on narrower ones.
NARROW = 1e-5

# --- Conflicts ----------------------------------------------------------------------------------------------------------

#: [of the sides] Rows that a step keeps to within this are kept together.
FEASIBLE = 1e-9
