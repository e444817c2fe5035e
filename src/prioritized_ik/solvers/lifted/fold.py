"""The levels of a problem on a kinematic tree, solved one after the other as sparse QPs."""

from collections.abc import Callable

from prioritized_ik.solvers.backends.sparse import SparseBackend, SparseResult
from prioritized_ik.solvers.lifted.stages import LiftedProblem, LiftedStage, LiftedState, level_stage, reference_stage
from prioritized_ik.validation import Array

#: Calls a backend, for instance under a clock.
Call = Callable[[LiftedStage], SparseResult]


def lifted_fold(backend: SparseBackend, lifted: LiftedProblem, call: Call | None = None) -> Array | str:
    """Return a sparse QP solver's u `(m,)`, in the joint metric, level by level, or why there is none.

    Args:
        backend: the solver.
        lifted: the problem.
        call: what calls the backend, itself unless given.
    """
    solve = call or backend.solve
    state = LiftedState.whole(lifted)
    for level in lifted.levels:
        stage = level_stage(state)
        if stage is None:
            state = state.skipped()
            continue
        result = solve(stage)
        if result.answer is None:
            return f"level {level.name!r}: {result.message}"
        state = state.after(stage, result.answer.x, result.answer.of_bounds, result.answer.of_rows)
    stage = reference_stage(state)
    result = solve(stage)
    return f"last level: {result.message}" if result.answer is None else stage.dtheta(result.answer.x)
