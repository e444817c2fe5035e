"""Every tolerance of the tests, each with its reason."""

ROUNDING = 1e-12  # a few hundred double operations of numbers near 1 lose 3 digits of 16 at most
FINITE_DIFFERENCE_STEP = 1e-5  # [rad] the cube root of rounding: truncation and cancellation are both near 1e-10
FINITE_DIFFERENCE = 1e-7  # largest error of a central difference with that step, relative to the largest entry
SABOTAGE = 1e-3  # a helper that cannot see an error this large proves nothing
DISTANCE_STEP = 1e-4  # [rad] above the 1e-6 m to which MuJoCo's iterative collision converges
DISTANCE_GRADIENT = 1e-4  # what that leaves of a distance gradient's accuracy; ellipsoids measure 1e-5
DISTANCE = 2e-6  # [m] MuJoCo's iterative collision stops at 1e-6 m
NORMAL = 1e-3  # the same 1e-6 m seen from a radius of 10 mm, with room for flat directions of the surface
ORACLE = 1e-10  # Eqs. (12) to (14) against an oracle that shares no code with them
WELL_CONDITIONED = 1e-4  # σ_34 / σ_1 from which on the closed form is held to `ORACLE`
