"""Every tolerance of the solve in one table: its unit, why this number, and what it separates.

Lengths are measured in the problem's joint metric, so that none of them depends on the units of joints or rows. "Of the
step" means relative to `Hierarchy.scale`; "of the row" means relative to the row's own length.
"""

import numpy as np

EPS = float(np.finfo(float).eps)

# --- What is rounding in the data ---------------------------------------------------------------------------------------

#: [–] A combination of rows of unit length this short is zero, unless a problem states the noise of its data. What doubles
#: leave of a zero in a Jacobian is about 1e-16 of its size. For whole rows see `ROUNDING`: their lengths have units.
NOISE = 1e-12

#: [–] Rows of unit length that differ by less than this angle say the same. Dividing by it leaves five digits.
DEPENDENT = 1e-11

#: [–] How much of a row must be left by the levels above, as a fraction of the rank tolerance, to count as a row. With the
#: windings' 1e-4 that is 1e-9: along them the fraction takes every value. At 3e-7 a level's loss had no bound; at rounding
#: a winding has several steps that are decided by it.
SETTLED_PER_RANK_TOLERANCE = 1e-5

#: [–] Rounding of a projection, in units of `EPS`, for up to a hundred joints.
PROJECTION = 16.0

#: [–] directions are never taken for less certain than this, however weak what a level kept
UNSURE = 1e-6

#: [–] A bound this many times what it is to be beyond is beyond it, whatever rounding makes of the bound.
CLEARLY = 2.0

#: [–] Steps of an estimate of a largest singular value, from the longest row: it is right to a few hundredths then.
ESTIMATES = 3

#: [–] A product of matrices of numbers with twice the digits of doubles is off by this much of a row and a column, a term.
FINEST = 2.0**-90

# --- What a certificate allows ------------------------------------------------------------------------------------------

#: [of the step] Violation of a hard row, and displacement that would still lower a level's cost.
CERTIFIED = 1e-8

#: [of the level's demand, squared] How much lower a level's cost could be. The gap is a product of multiplier and slack; a
#: step that misses 1e-5 of what a level could reach has 1e-10.
GAP = 1e-9

#: [of the step] How far rounding may move the step where the certificate holds.
UNDECIDED = 1e-4

#: [–] The conditions are differences of large terms where a level wants far more than the rows allow; this fraction of the
#: terms is noise: sixty products of two doubles each. So is a row this short beside the longest.
ROUNDING = 64 * EPS

#: [–] A direction without cost counts as felt this much weaker than the level's strongest, so that descents along it show.
UNFELT = 1e-2

#: [–] A multiplier below this fraction of a level's terms is none.
NOTHING = 1e-12

#: [of the step] Leaks of strong rows into weak directions up to this are looked at in double precision only.
LEAKS = 1e-5

#: [of what a step of this scale can do to a level] A level that asks for less asks for nothing.
LEAST_DEMAND = 1e-6

#: [of the step] A displacement below this is rounding that no estimate foresaw.
OFF = 1e-12

#: [of what rounding of doubles can feign] A displacement longer than this is known in doubles, to a hundredth.
PLAIN = 100.0

#: [–] Turns of a basis with twice the digits of doubles; each gains as many digits as the level's weakest direction leaves.
TURNS = 2

#: [–] Improvements of a combination with twice the digits of doubles; each gains as many digits as the rows leave.
BALANCINGS = 4

# --- The active set -----------------------------------------------------------------------------------------------------

#: [of the step] A row nearer than this to a solver's answer is guessed to be active.
GUESS = 1e-6

#: [of the step] A row exceeded by less than this is kept: rounding.
KEPT = 1e-10

#: [of the step] What a row moves by directions too weak to count that is rounding.
DRIFT = 1e-14

#: [of the step] A closed-form step that breaks no row by more than this, its own rounding, breaks none. A row broken by
#: 1e-12 that hardly moves where levels above leave it, 1e-9 of its length, is kept a thousandth of the step away.
FREE = ROUNDING

#: [–] A step this fraction of what the levels ask for counts as this long, so that steps of robots at rest have a scale:
#: what a certificate allows of it is no finer than the rounding of what the levels ask for.
FLOOR = ROUNDING / CERTIFIED

#: [–] Sets of active rows visited before the search from a guess is given up, of so many rows; of more, in proportion: 200
#: rows take up to 274 from a guess that is far off.
ITERATIONS = 60
ROWS_PER_SEARCH = 24

#: [–] Sets visited from the rows of the last step before these are given up for a search from nothing: so many, and one
#: more for so many rows. Where a winding's contacts change up to 40 sets lead on, which take ten times as long.
LEAST_SETS = 2
ROWS_PER_SET = 2

#: [–] Attempts to mend a step that is off by rounding.
REFINEMENTS = 3

#: [of the step] What is off by more, and by more than rounding of doubles can feign, is not off by rounding.
REFINABLE = 1e-2

# --- A guess from nothing ---------------------------------------------------------------------------------------------

#: [–] Directions along which a stage's cost hardly changes, followed or not, in turn: real in slivers, else rounding.
WEAK = (DEPENDENT, 1e-7)

#: [–] A multiplier above this fraction of the largest fixes its row; below, it stays an inequality, which does no harm.
FIXING = 1e-7

#: [of a stage's unit] A multiplier below this is none.
FAINT = 1e-9

#: [of the gradient's terms] A multiplier below minus this is negative.
NEGATIVE = 1e-11

#: [of the variables] A move shorter than this is none.
STILL = 1e-13

#: [–] Steps without progress before Bland's rule.
IDLE = 4

#: [–] Iterations per row and variable before the method gives up.
ROUNDS = 20

#: [of a soft level's unit] An excess below this is rounding.
EXCEEDED = 1e-9

# --- Backends -----------------------------------------------------------------------------------------------------------

#: [of the likely step] The unit of a QP: OSQP loses steps where a step measures one unit or more, ProxQP where it
#: measures a tenth.
AMPLE = 3.0

#: [of that unit] In the last stage the optimum is within 2 units of x = 0, which is feasible; slacks beyond this can be
#: cut to it without changing the optimum, and interior-point solvers start far off if they are not.
FAR_SLACK = 10.0

#: [–] Proximal steps of one solve; every zoom adds as many.
PROXIMAL_ROUNDS = 2

#: [of the costed variables' unit] ρ‖z - z_k‖ below this leaves no trace in them.
RESTED = 1e-10

#: [of the step] Zooming stops once it moves the step by less.
ZOOMED = 1e-9

#: [of the step] A solver's own step may break a row by this much; beyond, it is not accepted.
ACCEPTED_VIOLATION = 1e-6

#: [of the step] A row this close to a stage's answer is tight: three hundred times what a solver at accuracy 1e-8 leaves
#: open. At 1e-7 SCS lost one winding of four, at 3e-7 CVXOPT one of eight.
TIGHT = 3e-6

#: [–] How much of a row must be left to count as one in the QP that a solver gets: divided by less, rounding becomes a
#: constraint, and at 3e-7 and below ProxQP lost a winding. A solver only makes a guess, which the kernel corrects.
SETTLED_FOR_SOLVERS = 2e-6

#: [of the largest, at least of a stage's unit] In the lifted form a bound or row with a multiplier above this holds for the
#: levels below. A false one costs the kernel that starts there an exchange, a missing one leaves the next QP no interior.
HELD_MULTIPLIER = 1e-9

#: [of the size of step that the levels ask for] No bound or row further from the answer than this is held there.
HELD_SLACK = 1e-5

#: [–] Tight rows that leave a wedge narrower than this leave no room to a QP solver: ProxQP failed on one of 4e-5.
NARROW = 1e-4

# --- Conflicts ----------------------------------------------------------------------------------------------------------

#: [of the linear programme's unit] HiGHS keeps rows to within 1e-7, so a least violation above this is right to one in a
#: million.
RESOLVED = 0.1

#: [–] Linear programmes in search of a unit; each leaves a tenth of the violation at most, if it does not end it.
PASSES = 30

#: [–] A multiplier above this is positive: together they are 1, and HiGHS is right to 1e-7.
PUSHING = 1e-7

#: [of the sides] Rows that a step keeps to within this are kept together.
FEASIBLE = 1e-9

# --- The compiled core ----------------------------------------------------------------------------------------------------

#: [–] What must hold in the compiled core must hold with this fraction of its tolerance; otherwise the Python form answers.
MARGIN = 0.1

#: [–] The same for how far rounding may move a step, where all of its proof was looked at with twice the digits: what is
#: left is how far half a unit in the last place of the levels above turns a level, which is no estimate.
CLOSE_MARGIN = 0.5

#: [of `UNDECIDED`] What the compiled core finds undecided by more, the Python form would not certify either: their figures
#: are within a factor of three and a half of each other.
PLAINLY = 4.0

#: [–] A direction weaker than this, in rows of unit length, is one that the Python form looks at closer.
WEAKEST = 1e-6

#: [–] A row within this factor of what settles it may be one or none; rounding changes it by less.
NEARLY = 4.0

#: [of the cut] A singular value nearer than this to the rank tolerance may be on either side of it.
CUT_MARGIN = 1e-6

#: [–] What is left of the rows of a level, as a fraction of the longest, when nothing but rounding is.
EMPTY = 1e-14

# --- Elimination along a kinematic tree ----------------------------------------------------------------------------------

#: [of the row] What a row moves of what the rows before it leave, up to this, is zero, as in `NOISE`.
TREE_ZERO = NOISE

#: [of the row] The same where a step is not found so: nearly straight arms move single rows by some `NOISE` where no
#: combination of rows moves that far. Ranks are looked at anew then: all that is cut is below `NOISE`, or nothing is found.
NEAR_ZERO = 1e-10
