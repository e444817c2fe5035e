"""The door: a problem and the name of a method in, a joint step out."""

from dataclasses import replace

import numpy as np

from prioritized_ik.errors import InfeasibleError, InputError, StepNotFoundError
from prioritized_ik.problem import IKProblem
from prioritized_ik.solvers.backends.protocol import Backend
from prioritized_ik.solvers.lexicographic import STANDARD, SolveOptions, joint_step
from prioritized_ik.solvers.methods import Lexicographic, Method, Place
from prioritized_ik.solvers.registry import DEFAULT, get_method
from prioritized_ik.solvers.step import JointStep, StepStatus


def solve(problem: IKProblem, solver: str | Method | Backend = DEFAULT, options: SolveOptions | None = None) -> JointStep:
    """Return the joint step that is optimal at every level of `problem`.

    Args:
        problem: levels, bounds, rows, equalities and reference.
        solver: a method or the name of one, see `registry.get_method`; the bare name of a QP solver stands for
            `lexicographic:` and that solver, and so does a backend. A method made once remembers its last step, if it
            starts warm.
        options: see `SolveOptions`.

    Raises:
        InputError: an argument of another kind.
        SolverUnavailableError: unknown method, or not installed.
        InfeasibleError: no step keeps all hard rows; it names those in conflict.
        StepNotFoundError: the solver failed or broke a row; the exception keeps the step's figures.
    """
    if not isinstance(problem, IKProblem):
        raise InputError(f"problem is {_kind(problem)}; expected an IKProblem, with its levels and limits.")
    if options is not None and not isinstance(options, SolveOptions):
        raise InputError(f"options is {_kind(options)}; expected SolveOptions.")
    if not isinstance(solver, str | Method) and isinstance(solver, Backend):  # which asks for its version, from a file
        solver = Lexicographic(solver)
    if not isinstance(solver, str | Method):
        raise InputError(
            f"solver is {_kind(solver)}; expected a name such as {DEFAULT!r} or 'daqp', or what get_method returned "
            "(limits belong into the IKProblem, options into options=)."
        )
    options = options or STANDARD
    method = get_method(solver, options.accuracy) if isinstance(solver, str) else solver
    step = step_of(method, problem, options)
    if step.conflict is not None:
        raise InfeasibleError(str(step.conflict), step)
    if step.dtheta is None:
        raise StepNotFoundError(f"{method.name}: {step.status.value}. {step.message}".rstrip(), step)
    return step


def step_of(method: Method, problem: IKProblem, options: SolveOptions, place: Place | None = None) -> JointStep:
    """Return a method's step as data; one that came without a certificate is given one, and refused if it breaks a row.

    Raises:
        InputError: the method does not know such a problem or options, or what it returned is no step.
    """
    step = method.step(problem, options, place)
    if not isinstance(step, JointStep):
        raise InputError(f"{method.name} returned {_kind(step)}; expected a JointStep.")
    if step.dtheta is not None and not step.is_judged:
        return _certified(method, problem, step, options)
    return step.made_by(method.name)


def _certified(method: Method, problem: IKProblem, step: JointStep, options: SolveOptions) -> JointStep:
    """Return a step judged by the problem alone."""
    dtheta = np.asarray(step.dtheta, dtype=float)
    if dtheta.shape != (problem.joint_count,) or not np.isfinite(dtheta).all():
        message = f"{method.name} returned dθ of shape {dtheta.shape}; expected ({problem.joint_count},), all of it finite"
        return replace(step, dtheta=None, status=StepStatus.NOT_FOUND, message=message, method=method.name)
    judged = joint_step(
        problem,
        lambda problem, hierarchy, clock: problem.to_metric(dtheta),
        replace(options, damping=None, polish=False, closed_form_first=False),
        method.name,
    )
    return replace(judged, timings=step.timings, calls=step.calls, message=step.message or judged.message)


def _kind(value: object) -> str:
    return f"{value!r} ({type(value).__name__})" if len(repr(value)) < 60 else f"of type {type(value).__name__}"
