"""`solve_ik` as in mink, `step_ik`, and `build_problem`."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import mink
import mujoco
from mink.tasks import BaseTask

from prioritized_ik.errors import InfeasibleError, InputError, StepNotFoundError
from prioritized_ik.mink.errors import InfeasibleIkError, NoStepFoundError, OutsideLimitsError
from prioritized_ik.mink.hard import hard_limits, hard_tasks
from prioritized_ik.mink.levels import Tasks, grouped, levels_of
from prioritized_ik.problem import BELOW, IKProblem, posed_problem
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.methods import DAMPING, Method
from prioritized_ik.solvers.registry import DEFAULT
from prioritized_ik.solvers.solve import solve
from prioritized_ik.solvers.step import JointStep
from prioritized_ik.validation import Array, non_negative, one_of, positive

#: Arguments of `qpsolvers.solve_problem` that change nothing here: to be quiet, and where to start from nothing.
NOTHING_ASKED = {"verbose": False, "initvals": None}


def build_problem(
    configuration: mink.Configuration,
    tasks: Tasks,
    dt: float,
    damping: float = DAMPING,
    limits: Sequence[mink.Limit] | None = None,
    constraints: Sequence[mink.Task] | None = None,
    *,
    priority: Mapping[BaseTask, int] | None = None,
    below: str = "hold",
) -> IKProblem:
    """Return the problem of the next displacement Δq `(nv,)`, without solving it.

    Args:
        configuration: mink's, up to date.
        tasks: mink's; all in one level, or lists of them, one a level, the most important first.
        dt: time step [s].
        damping: of every level, added to what the tasks' `lm_damping` makes: mink's `damping` where there is one level.
        limits: mink's; None for its default, `ConfigurationLimit`; empty for none.
        constraints: tasks to be met exactly.
        priority: the level of each task, smaller numbers first, in place of nested lists.
        below: what levels leave to those below: "free", every motion that does not change what their damped optimum
            reaches; "hold", none at all where a level's `lm_damping` takes more than half of its weakest direction, which
            keeps the robot calm with targets out of reach.

    Raises:
        InputError: an argument out of range or of another model.
        InfeasibleIkError: a limit or constraint that no joint moves, and that is not kept.
        mink.MinkError: what mink's tasks and limits raise, such as a target that was not set.
    """
    if not isinstance(configuration, mink.Configuration):
        raise InputError(f"configuration is {type(configuration).__name__}; expected a mink.Configuration.")
    positive("dt", dt)
    non_negative("damping", damping)
    one_of("below", below, BELOW)
    _update_tendons(configuration)
    levels = levels_of(configuration, grouped(tasks, priority), damping, below)
    bounds, rows = hard_limits(configuration, limits, dt)
    return posed_problem(levels, bounds, rows, hard_tasks(configuration, constraints))


def _update_tendons(configuration: mink.Configuration) -> None:
    """Bring the Jacobians of coupled tendons up to date, which mink leaves as they were."""
    model, data = configuration.model, configuration.data
    if model.neq and (model.eq_type == mujoco.mjtEq.mjEQ_TENDON).any():
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)


def solve_ik(
    configuration: mink.Configuration,
    tasks: Tasks,
    dt: float,
    solver: str | Method = DEFAULT,
    damping: float = DAMPING,
    safety_break: bool = False,
    limits: Sequence[mink.Limit] | None = None,
    constraints: Sequence[mink.Task] | None = None,
    *,
    priority: Mapping[BaseTask, int] | None = None,
    below: str = "hold",
    options: SolveOptions | None = None,
    **kwargs: Any,
) -> Array:
    """Return the velocity `(nv,)` [rad/s, m/s for slides] that `mink.solve_ik` asks for, with strict levels.

    Where rounding leaves the optimum open, the step is still returned: it keeps every limit, and `step_ik` tells how far
    it may be off.

    Args:
        configuration: see `build_problem`.
        tasks: see `build_problem`.
        dt: see `build_problem`.
        solver: any name that mink takes, a name of `known_methods()`, or what `get_method` returned; none is called unless
            given, and the answer does not depend on it.
        damping: see `build_problem`.
        safety_break: whether a configuration outside its joint limits is an error.
        limits: see `build_problem`.
        constraints: see `build_problem`.
        priority: see `build_problem`.
        below: see `build_problem`.
        options: of the solve.
        **kwargs: options of the QP solver that mink would call; they are named in a warning, and of no effect.

    Raises:
        InputError: see `build_problem`.
        OutsideLimitsError: outside the joint limits with `safety_break`; also a `mink.NotWithinConfigurationLimits`.
        InfeasibleIkError: no step keeps all limits and constraints; it names those in conflict; also a
            `mink.NoSolutionFound`.
        NoStepFoundError: the solver failed; also a `mink.NoSolutionFound`.
        SolverUnavailableError: unknown solver, or not installed.
        mink.MinkError: see `build_problem`.
    """
    _warn_of(kwargs)
    _check_limits(configuration, safety_break)
    problem = build_problem(configuration, tasks, dt, damping, limits, constraints, priority=priority, below=below)
    dtheta = _solved(problem, solver, options).dtheta
    assert dtheta is not None  # `solve` raises where there is no step
    return dtheta / dt


def step_ik(
    configuration: mink.Configuration,
    tasks: Tasks,
    dt: float,
    solver: str | Method = DEFAULT,
    damping: float = DAMPING,
    safety_break: bool = False,
    limits: Sequence[mink.Limit] | None = None,
    constraints: Sequence[mink.Task] | None = None,
    *,
    priority: Mapping[BaseTask, int] | None = None,
    below: str = "hold",
    options: SolveOptions | None = None,
    **kwargs: Any,
) -> JointStep:
    """Move `configuration` by the step that `solve_ik` finds, and return the step with its certificate.

    The arguments and errors are those of `solve_ik`. `step.dtheta` is the displacement Δq `(nv,)`; the configuration is
    left where it was if there is an error.
    """
    _warn_of(kwargs)
    _check_limits(configuration, safety_break)
    problem = build_problem(configuration, tasks, dt, damping, limits, constraints, priority=priority, below=below)
    step = _solved(problem, solver, options)
    configuration.integrate_inplace(step.dtheta, 1.0)
    return step


def _solved(problem: IKProblem, solver: str | Method, options: SolveOptions | None) -> JointStep:
    """Return the step, with what goes wrong as mink's exceptions too."""
    try:
        return solve(problem, solver, options)
    except InfeasibleError as error:
        raise InfeasibleIkError(str(error), error.step) from error
    except StepNotFoundError as error:
        raise NoStepFoundError(str(error), error.step) from error


def _check_limits(configuration: mink.Configuration, safety_break: bool) -> None:
    """Stop if the configuration is outside its joint limits and `safety_break` asks for it; let mink log it otherwise."""
    if not isinstance(configuration, mink.Configuration):
        raise InputError(f"configuration is {type(configuration).__name__}; expected a mink.Configuration.")
    try:
        configuration.check_limits(safety_break=safety_break)
    except mink.NotWithinConfigurationLimits as error:
        raise OutsideLimitsError(f"{error}; move it inside, or go on with safety_break=False.") from error


def _warn_of(kwargs: Mapping[str, Any]) -> None:
    """Name the options of a QP solver that are not heeded here, in one warning at the caller's line."""
    ignored = [f"{name}={value!r}" for name, value in kwargs.items() if NOTHING_ASKED.get(name, kwargs) is not value]
    if ignored:
        warnings.warn(
            f"not heeded: {', '.join(ignored)}. The step is made exact and proven whatever a QP solver's own options; how "
            "it is solved is told by options=SolveOptions(…).",
            stacklevel=3,
        )
