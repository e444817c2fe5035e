"""Whatever comes in: a step that means what was asked, or one error of this package that says what to do."""

import mujoco
import numpy as np
import pytest

import prioritized_ik as pik
from prioritized_ik.limits import joint_metric

EYE = np.eye(2)
BOX = pik.Bounds([-1.0, -1.0], [1.0, 1.0])
SOLVERS = ("active-set", "daqp", "quadprog", "proxqp", "daqp-hierarchy", "osqp-warm", "clarabel")

#: What means nothing is accepted: the problem, and its step.
MEANINGLESS = {
    "no level at all": (pik.IKProblem([], BOX, reference=[3.0, 0.5]), [1.0, 0.5]),
    "a level without rows": (pik.IKProblem([pik.Level(np.zeros((0, 2)), []), pik.Level(EYE, [1.0, 2.0])], BOX), [1.0, 1.0]),
    "a row without weight": (pik.IKProblem([pik.Level(EYE, [1.0, 2.0], [0.0, 1.0])], BOX), [0.0, 1.0]),
    "a level that no joint moves": (pik.IKProblem([pik.Level(0.0 * EYE, [1.0, 2.0])], BOX), [0.0, 0.0]),
    "an infinite side": (pik.IKProblem([pik.Level(EYE, [1.0, 2.0])], rows=pik.Rows(EYE, [np.inf, 1.0])), [1.0, 1.0]),
    "a soft target of infinity": (pik.IKProblem([pik.Level(EYE, [np.inf, -0.5], kind="at_most")], BOX), [0.0, -0.5]),
    "all joints frozen": (pik.IKProblem([pik.Level(EYE, [1.0, 2.0])], pik.Bounds([0.5, 0.5], [0.5, 0.5])), [0.5, 0.5]),
}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("problem", "wanted"), MEANINGLESS.values(), ids=MEANINGLESS)
def test_what_means_nothing_is_accepted_and_means_nothing(solver, problem, wanted):
    step = pik.solve(problem, solver)
    assert step.certificate.holds
    assert step.dtheta == pytest.approx(wanted, abs=1e-12)


REFUSED = {
    "no number of joints": (lambda: pik.IKProblem([]), "no number of joints"),
    "a side of minus infinity": (lambda: pik.Rows([[1.0, 0.0]], [-np.inf]), "is -inf, which no step can keep"),
    "a negative metric": (
        lambda: pik.IKProblem([], BOX, metric=[1.0, -1.0]),
        r"metric\[1\] is -1.0; expected numbers above 0",
    ),
    "a skew metric": (lambda: pik.IKProblem([], BOX, metric=[[2.0, 1.0], [0.0, 2.0]]), "differs from its transpose"),
    "a singular metric": (lambda: pik.IKProblem([], BOX, metric=[[1.0, 1.0], [1.0, 1.0]]), "expected a positive definite"),
    "too much noise": (lambda: pik.IKProblem([], BOX, noise=0.5), "noise is 0.5; expected a number above 0 and below 0.01"),
    "no noise": (lambda: pik.IKProblem([], BOX, noise=0.0), "noise is 0.0; expected a number above 0"),
    "a tolerance below rounding": (
        lambda: pik.certify(pik.IKProblem([], BOX), [0.0, 0.0], tolerance=1e-20),
        r"^tolerance is 1e-20, less than rounding leaves in doubles; expected at least 1e-14",
    ),
    "a rank tolerance below rounding": (lambda: pik.SolveOptions(rank_tolerance=1e-17), "less than rounding leaves"),
    "negative damping": (lambda: pik.Level(EYE, [1.0, 2.0], damping=-1.0), "damping of level 'task' is -1.0"),
    "damped inequalities": (lambda: pik.Level(EYE, [1.0, 2.0], kind="at_most", damping=1.0), "soft inequalities have none"),
    "an unknown below": (lambda: pik.Level(EYE, [1.0, 2.0], below="x"), "choose one of: free, hold"),
    "a negative weight": (
        lambda: pik.Level(EYE, [1.0, 2.0], [1.0, -1.0]),
        r"\[1\] is -1.0; expected numbers of at least 0",
    ),
    "crossed bounds": (lambda: pik.Bounds([0.0, 1.0], [1.0, 0.0]), "'joint 2 lower' is 1.0, above 'joint 2 upper', 0.0"),
    "a number beyond all units": (
        lambda: pik.Level(1e200 * EYE, [1.0, 2.0]),
        "expected at most 1e.100: choose other units",
    ),
    "limits in the place of a solver": (lambda: pik.solve(pik.IKProblem([], BOX), BOX), "solver is of type Bounds"),
    "options in the place of a solver": (lambda: pik.solve(pik.IKProblem([], BOX), pik.SolveOptions()), "solver is"),
    "a list in the place of a problem": (lambda: pik.solve([]), "expected an IKProblem"),
    "a dictionary of options": (lambda: pik.solve(pik.IKProblem([], BOX), options={}), "expected SolveOptions"),
    "damping where there is none": (
        lambda: pik.solve(pik.IKProblem([], BOX), options=pik.SolveOptions(damping=1.0)),
        "damp a level instead",
    ),
}


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED)
def test_bad_input_is_one_clear_message(make, message):
    with pytest.raises(pik.InputError, match=message):
        make()


def test_a_solver_that_does_not_exist_is_told_with_those_that_do():
    with pytest.raises(pik.SolverUnavailableError, match=r"unknown solver 'active'; did you mean 'active-set'.*daqp"):
        pik.solve(pik.IKProblem([], BOX), "active")


def test_a_row_of_rounding_that_no_step_can_keep_is_a_conflict_and_one_that_any_keeps_is_reported():
    want = pik.Level(EYE, [0.1, 0.2])
    with pytest.raises(pik.InfeasibleError, match="'wall' is moved by no joint"):
        pik.solve(pik.IKProblem([want], rows=pik.Rows([[1e-17, 0.0]], [-1.0], ["wall"])))
    step = pik.solve(pik.IKProblem([want], rows=pik.Rows([[1e-17, 0.0]], [0.0], ["wall"])))
    assert step.zeros == ("wall",)
    assert step.dtheta == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1.0, 1e6])
@pytest.mark.parametrize("solver", ["active-set", "daqp", "quadprog"])
def test_a_step_of_any_size_is_the_same_step(solver, size):
    rows = pik.Rows([[1.0, 1.0]], [1.2 * size])
    level = pik.Level([[1.0, 0.3], [0.2, 1.0]], [2.0 * size, 0.5 * size])
    step = pik.solve(pik.IKProblem([level], pik.Bounds([-size] * 2, [size] * 2), rows), solver)
    one = pik.solve(pik.IKProblem([pik.Level(level.matrix, level.target / size)], BOX, pik.Rows([[1.0, 1.0]], [1.2])))
    assert step.certificate.holds
    assert step.dtheta / size == pytest.approx(one.dtheta, rel=1e-12)


class TestJointMetric:
    """Metres beside radians."""

    BASE_AND_ARM = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/>
      <body pos="0 0 .5"><joint name="turn" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".02"/></body>
    </body></worldbody></mujoco>"""

    def test_a_slide_weighs_one_over_a_length_squared_and_a_hinge_one(self):
        model = mujoco.MjModel.from_xml_string(self.BASE_AND_ARM)
        assert joint_metric(model, 0.5) == pytest.approx([4.0, 1.0])
        assert joint_metric(model) == pytest.approx([4.0 / model.stat.extent**2, 1.0])

    def test_of_a_free_base_the_translations_are_lengths(self):
        xml = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
        assert joint_metric(mujoco.MjModel.from_xml_string(xml), 2.0) == pytest.approx([0.25] * 3 + [1.0] * 3)

    def test_a_length_that_is_not_positive_is_refused(self):
        with pytest.raises(pik.InputError, match=r"length is 0\.0"):
            joint_metric(mujoco.MjModel.from_xml_string(self.BASE_AND_ARM), 0.0)
