"""One table of what each solver can do, and how one accuracy becomes each solver's own options.

The oddities were measured on the recorded winding steps (49 joints, whitened stages; see the README for the figures):

- quadprog and ecos need a positive definite Hessian, and cvxopt one that its rows make definite; daqp takes a semidefinite
  one, but its automatic proximal mode stops early; highs cycles for seconds on one. They get the proximal point.
- clarabel, cvxopt, piqp, scs: the weakest directions of a free step stay off by up to 1e-1 even at tolerance 1e-10, because
  the complementarity of inactive rows pushes on them. A zoom or two bring them to 1e-8.
- ecos minimises through an epigraph cone: a cost right to ε leaves x right to about √ε only. Three zooms.
- highs adds 1e-7 to its Hessian's diagonal: a zoom removes that.
- daqp, quadprog, proxqp: where rows bind, the weak directions rest on tiny multipliers, which a shift or a tolerance of
  1e-8 disturbs: a zoom mends that. A shift of 1e-8 leaves two steps in 400 off by 70 %, at a cost within 1e-9; daqp and
  quadprog bear 1e-10, which finds them. ecos and highs bear 1e-8; cvxopt loses one step in eight with that.
- cvxopt and ecos miss dX by more than 1e-6 on 6 and 2 of 126 steps where rows bind: by up to 2e-4 and 3e-5, at a cost
  within 3e-8, where all others keep to 2e-8. A comparison allows for that, and for no more (`strays`).
- jaxopt_osqp and qpax compute in single precision, and then find nothing, unless the environment sets JAX_ENABLE_X64=1.
- osqp's polishing writes to standard output where no row binds, even when told to be quiet, so it stays off.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

ITERATIONS = 100_000  # of first-order solvers; OSQP takes up to 36,000 to the accuracy asked for

CVXOPT_FEASTOL = 1e-4  # primal residuals end far below that

Options = Mapping[str, float | int | bool | str]


@dataclass(frozen=True)
class Abilities:
    """One solver of qpsolvers.

    Attributes:
        package: what to `pip install`.
        options: accuracy -> keyword options for the solver.
        semidefinite: solves a stage with variables that have no cost, without help.
        shift: ρ of the proximal point, for those that need it; variables with a cost weigh 1.
        sparse: takes SciPy sparse matrices (and complains about dense ones).
        warm_start: can start from a point given; native ones do, from the step before, and through qpsolvers none does.
        zooms: see `refinement.zoom_in`.
        strays: how far, relative, its dX is known to be off on a few of the steps where rows bind, see above.
        finest: the finest accuracy that it takes; beyond, double precision or its own limits are in the way.
        on_request: runs only when asked for by name.
        module: what a solver is imported as that is called through its own interface; empty through qpsolvers.
    """

    package: str
    options: Callable[[float], Options] = field(default=lambda accuracy: {})
    semidefinite: bool = True
    shift: float = 1e-6
    sparse: bool = False
    warm_start: bool = False
    zooms: tuple[float, ...] = ()
    strays: float = 0.0
    finest: float = 1e-12
    on_request: bool = False
    module: str = ""

    @property
    def native(self) -> bool:
        """Whether the solver is called through its own interface."""
        return bool(self.module)


def _eps(accuracy: float) -> Options:
    return {"eps_abs": accuracy, "eps_rel": accuracy}


ABILITIES: dict[str, Abilities] = {
    "clarabel": Abilities(
        "clarabel",
        lambda a: {"tol_gap_abs": a, "tol_gap_rel": a, "tol_feas": a},
        sparse=True,
        zooms=(1e-3,),
    ),
    # Ten times: CVXOPT gives up on tighter ones where rows bind. Its normal equations lose the dual residual, which
    # feastol bounds too, as the gap falls: where rows are nearly parallel 1e-4 is left. Zooming in mends that.
    "cvxopt": Abilities(
        "cvxopt",
        lambda a: {"abstol": 10 * a, "reltol": 10 * a, "feastol": max(10 * a, CVXOPT_FEASTOL)},
        semidefinite=False,
        warm_start=True,
        zooms=(1e-3, 1e-5),
        strays=5e-4,
    ),
    # A hundredth: DAQP is an active-set method, whose tolerances decide on rows and do not cost time.
    "daqp": Abilities(
        "daqp",
        lambda a: {"primal_tol": a / 100, "dual_tol": a / 10_000},
        semidefinite=False,
        shift=1e-10,
        zooms=(1e-3,),
    ),
    # A hundred times: ECOS gives up on tighter ones more often than it gains.
    "ecos": Abilities(
        "ecos",
        lambda a: dict.fromkeys(("abstol", "reltol", "feastol"), 100 * a),
        semidefinite=False,
        shift=1e-8,
        sparse=True,
        zooms=(1e-2, 1e-4, 1e-6),
        strays=1e-4,
    ),
    "highs": Abilities(
        "highspy",
        # Not below 1e-10, which HiGHS refuses. The time limit [s] ends its cycling, which no other option does.
        lambda a: {
            "primal_feasibility_tolerance": max(a / 100, 1e-10),
            "dual_feasibility_tolerance": max(a / 100, 1e-10),
            "time_limit": 1.0,
        },
        semidefinite=False,
        shift=1e-8,
        sparse=True,
        zooms=(1e-3,),
        finest=1e-8,
    ),
    # A hundredth, for want of zooms: on a zoomed stage OSQP and QPALM run into their iteration limits.
    "osqp": Abilities(
        "osqp",
        lambda a: {**_eps(a / 100), "max_iter": ITERATIONS},
        sparse=True,
        warm_start=True,
    ),
    "piqp": Abilities("piqp", _eps, zooms=(1e-3,)),
    # A hundredth: on weak directions a row broken by 1e-8 in scaled variables is one broken by 1e-5 rad.
    "proxqp": Abilities("proxsuite", lambda a: _eps(a / 100), warm_start=True, zooms=(1e-3,)),
    "qpalm": Abilities(
        "qpalm",
        lambda a: {**_eps(a / 100), "max_iter": ITERATIONS},
        sparse=True,
        warm_start=True,
    ),
    "quadprog": Abilities("quadprog", semidefinite=False, shift=1e-10, zooms=(1e-3,)),
    "scs": Abilities(
        "scs",
        lambda a: {**_eps(a), "max_iters": ITERATIONS},
        sparse=True,
        warm_start=True,
        zooms=(1e-3,),
    ),
    "jaxopt_osqp": Abilities("jaxopt", lambda a: {"tol": a}, semidefinite=False, on_request=True),
    "kvxopt": Abilities(
        "kvxopt",
        lambda a: dict.fromkeys(("abstol", "reltol", "feastol"), 10 * a),
        semidefinite=False,
        zooms=(1e-3, 1e-5),
        on_request=True,
    ),
    "pyqpmad": Abilities("pyqpmad", semidefinite=False, on_request=True),
    "qpax": Abilities("qpax", lambda a: {"solver_tol": a}, semidefinite=False, zooms=(1e-3, 1e-5), on_request=True),
    "qtqp": Abilities("qtqp", sparse=True, zooms=(1e-3, 1e-5), on_request=True),
}


def _proxqp_warm(accuracy: float) -> Options:
    """What a start near the end takes: complementarity is checked, penalties are near their final size.

    At its default of 1e-4 such starts also pass for signs of infeasibility.
    """
    gap = {"check_duality_gap": True, "eps_duality_gap_abs": accuracy}
    return {**ABILITIES["proxqp"].options(accuracy), **gap, "default_mu_in": 1e-4, "eps_primal_inf": 1e-8}


#: Solvers through their own interfaces, see `native`. What is not stated is as through qpsolvers.
NATIVE: dict[str, Abilities] = {
    # Without a zoom, which costs half as much again: one solve finds the tight rows, and the polish does the rest.
    "daqp-warm": replace(ABILITIES["daqp"], module="daqp", warm_start=True, zooms=()),
    "osqp-warm": replace(ABILITIES["osqp"], module="osqp", warm_start=True),
    "piqp-warm": replace(ABILITIES["piqp"], module="piqp"),
    "proxqp-sparse-warm": replace(
        ABILITIES["proxqp"], module="proxsuite", warm_start=True, sparse=True, options=_proxqp_warm
    ),
    "proxqp-warm": replace(ABILITIES["proxqp"], module="proxsuite", warm_start=True, options=_proxqp_warm),
}


#: Solvers of sparse QPs and what they are imported as, see `sparse`; what they can do is as through qpsolvers.
SPARSE = {"clarabel": "clarabel", "highs": "highspy", "osqp": "osqp", "piqp": "piqp", "proxqp": "proxsuite"}


def abilities_of(name: str) -> Abilities:
    """Return what solver `name` can do; one that the table lacks counts as careful: dense, positive definite only."""
    return NATIVE.get(name) or ABILITIES.get(name, Abilities(name, semidefinite=False, on_request=True))
