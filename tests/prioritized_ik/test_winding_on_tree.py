import numpy as np
import pytest
from click.testing import CliRunner

from prioritized_ik.cli import main
from prioritized_ik.models import Arm, arm_model, winding_model
from prioritized_ik.solvers.lexicographic import SolveOptions
from prioritized_ik.solvers.registry import get_method
from prioritized_ik.solvers.step import StepStatus
from prioritized_ik.solvers.tree.step import PATH
from prioritized_ik.tree_problem import TreeLevel, TreeRows
from prioritized_ik.winding.controller import WindingController
from prioritized_ik.winding.settings import WindingSettings


def _controller(kinematics: str, links: int = 12, weights: str = "eq23") -> WindingController:
    options = SolveOptions(kinematics=kinematics)
    return WindingController(
        WindingSettings(arm=Arm(links=links), weights=weights, posture="random", seed=3, options=options)
    )


def _posed(controller: WindingController):
    settings = controller.settings
    q = settings.initial_posture()
    situation = controller.observe(q, np.arange(controller.chain.count) < 6)
    return controller.problem(q, situation)


@pytest.mark.parametrize("weights", ["eq23", "eq24", "strict"])
def test_a_controller_poses_the_same_problem_on_the_tree_as_in_matrices(weights):
    tree, dense = (_posed(_controller(kinematics, weights=weights)) for kinematics in ("tree", "dense"))
    assert all(isinstance(level, TreeLevel) for level in tree.levels)
    assert isinstance(tree.rows, TreeRows)
    assert tree.rows.names == dense.rows.names != ()
    for one, other in zip((*tree.levels, tree.rows), (*dense.levels, dense.rows), strict=True):
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-14)
    for one, other in zip(tree.levels, dense.levels, strict=True):
        np.testing.assert_array_equal(one.target, other.target)
        np.testing.assert_array_equal(one.weights, other.weights)
    np.testing.assert_array_equal(tree.rows.upper, dense.rows.upper)
    np.testing.assert_array_equal(tree.bounds.upper, dense.bounds.upper)


def test_a_winding_goes_along_the_links_and_keeps_what_it_knew():
    controller, method = _controller("tree", links=20), get_method("active-set")
    q, touching = controller.settings.initial_posture(), np.zeros(20, dtype=bool)
    paths = []
    for _ in range(12):
        situation = controller.observe(q, touching)
        touching = situation.in_contact
        problem = controller.problem(q, situation)
        step = method.step(problem, controller.settings.options)
        assert step.status in (StepStatus.SOLVED, StepStatus.CLOSED_FORM)
        assert not any("matrix" in vars(part) for part in (*problem.levels, problem.rows))
        paths.append(step.path)
        q = controller.chain.moved(q, step.dtheta)
    assert paths.count(PATH) >= 11


def test_a_model_is_compiled_once_and_handed_out_as_a_copy():
    arm, wound = Arm(links=3), WindingSettings(arm=Arm(links=3), link=1).wound_object()
    for make in (lambda: arm_model(arm), lambda: winding_model(arm, wound)):
        one, other = make(), make()
        one.geom_size[0] = 7.0
        assert other.geom_size[0, 0] != 7.0
        assert make().geom_size[0, 0] == other.geom_size[0, 0]


def test_the_command_line_takes_the_form_and_refuses_others():
    short = ["wind", "--links", "8", "--link", "3", "--steps", "3"]
    told = CliRunner().invoke(main, [*short, "--kinematics", "tree", "--rank-tolerance", "0", "--posture", "random"])
    assert told.exit_code in (0, 1), told.output
    wrong = CliRunner().invoke(main, [*short, "--kinematics", "lifted"])
    assert wrong.exit_code == 2
    assert "kinematics" in wrong.output
    assert "tree" in wrong.output
