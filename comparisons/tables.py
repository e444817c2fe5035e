"""The columns of the results: what each is, and its type. Errors are relative, times in seconds, lengths in metres.

Who and what (`JOB`), where and with what it was computed (`ORIGIN`), then the figures. Columns that compare a row with
others (`COMPARED`) are not stored but computed when the rows are read.
"""

from typing import Any

import polars

Record = dict[str, Any]
Schema = dict[str, polars.DataType | type[polars.DataType]]

_VECTOR = polars.List(polars.Float64)

#: `accuracy` is null where none is asked for: the damped formulation, mink and the closed form.
JOB: Schema = {
    "case": polars.String,
    "direction": polars.String,  # of a winding
    "solver": polars.String,
    "version": polars.String,
    "formulation": polars.String,
    "accuracy": polars.Float64,
    "start": polars.String,
    "repeat": polars.Int64,
}

#: `settings` is the beginning of their SHA-256, `code` that of the program's.
ORIGIN: Schema = {"cpu": polars.String, "revision": polars.String, "code": polars.String, "settings": polars.String}

STEPS: Schema = {
    "step": polars.Int64,
    "free": polars.Boolean,  # whether no row binds
    "status": polars.String,
    "message": polars.String,
    "found": polars.Boolean,
    "failure": polars.String,  # one of `isolation.FAILURES`, or null
    "build_s": polars.Float64,
    "solve_s": polars.Float64,
    "polish_s": polars.Float64,  # includes the certificates that steer it
    "certificate_s": polars.Float64,  # of certifying the solver's own answer, by itself; of the first repeat only
    "violation": polars.Float64,
    "cost": polars.Float64,
    "cost_at_zero": polars.Float64,
    "dtheta": _VECTOR,  # the solver's own answer
    "dtheta_error": polars.Float64,  # of that on free steps
    "dx_error": polars.Float64,
    "own_certificate": polars.Float64,  # worst figure of that answer's certificate
    "certified": polars.Boolean,  # from here on: of the polished step
    "own_guess": polars.Boolean,  # made of the solver's answer; if not, by the kernel from nothing
    "certificate": polars.Float64,
    "certified_dtheta": _VECTOR,
    "certified_dx_error": polars.Float64,  # ‖W^½ (dX - dX_certified)‖ / ‖W^½ dX*‖ of the solver's own dX
    "repairs": polars.Int64,
}
STEP_FIGURES = tuple(STEPS)

COMPARED: Schema = {
    "cost_gap": polars.Float64,
    "dtheta_spread": polars.Float64,
    "certified_spread": polars.Float64,
    "certified_same_bits": polars.Boolean,
}

EPISODES: Schema = {
    "outcome": polars.String,
    "done": polars.Boolean,  # wound; of a scene, whether it ended as it did when it was recorded
    "message": polars.String,
    "failure": polars.String,
    "steps": polars.Int64,
    "error": polars.Float64,  # of a scene, the largest of its required tasks at the end [m, rad]
    "turns": polars.Float64,
    "turns_ratio": polars.Float64,
    "penetration": polars.Float64,
    "bend": polars.Float64,
    "hinge_excess": polars.Float64,
    "drift": polars.Float64,
    "driven_together": polars.Int64,
    "flips": polars.Int64,
    "file": polars.String,  # of the episode, from the folder of the results; null if there is none
}

QPS: Schema = {
    "qp": polars.String,
    "solver": polars.String,
    "version": polars.String,
    "accuracy": polars.Float64,
    "repeat": polars.Int64,
    "found": polars.Boolean,
    "failure": polars.String,
    "message": polars.String,
    "solve_s": polars.Float64,
    "primal_residual": polars.Float64,
    "dual_residual": polars.Float64,
    "duality_gap": polars.Float64,
}
