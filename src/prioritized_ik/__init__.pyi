# model
from .models import Arm as Arm
from .models import WindingObject as WindingObject
from .models import update_kinematics as update_kinematics

# virtual arms
from .virtual_arms import EndPoint as EndPoint
from .virtual_arms import VirtualArms as VirtualArms

# robot
from .robot import Robot as Robot
from .examples import example as example

# tasks
from .tasks.position import Position as Position
from .tasks.orientation import Orientation as Orientation
from .tasks.pose import Pose as Pose
from .tasks.axis import Axis as Axis
from .tasks.axis import LookAt as LookAt
from .tasks.centre_of_mass import CentreOfMass as CentreOfMass
from .tasks.posture import Posture as Posture
from .tasks.joint_coupling import JointCoupling as JointCoupling
from .tasks.damping import Damping as Damping
from .tasks.arms import VirtualArmsTask as VirtualArmsTask
from .tasks.task import Task as Task

# problem
from .problem import Bounds as Bounds
from .problem import Equalities as Equalities
from .problem import IKProblem as IKProblem
from .problem import Level as Level
from .problem import Rows as Rows
from .kinematic_tree import KinematicTree as KinematicTree
from .kinematic_tree import PointRows as PointRows
from .model_tree import ModelTree as ModelTree
from .tree_problem import TreeLevel as TreeLevel
from .tree_problem import TreeRows as TreeRows
from .problem_file import load_problem as load_problem
from .problem_file import save_problem as save_problem
from .recording import Recording as Recording
from .live import LiveProblem as LiveProblem
from .posing import Posing as Posing
from .touch import TouchSensor as TouchSensor
from .limits import contact_rows as contact_rows
from .limits import joint_metric as joint_metric
from .limits import joint_range_bounds as joint_range_bounds
from .limits import step_bounds as step_bounds
from .guard import Limit as Limit
from .joint_limits import Acceleration as Acceleration
from .joint_limits import JointRange as JointRange
from .joint_limits import Velocity as Velocity
from .collision import Collision as Collision
from .model_equalities import ModelEqualities as ModelEqualities
from .support import SupportPolygon as SupportPolygon

# solve
from .solvers.lexicographic import SolveOptions as SolveOptions
from .solvers.solve import solve as solve
from .solvers.methods import Method as Method
from .solvers.registry import get_method as get_method
from .solvers.registry import installed_methods as installed_methods
from .solvers.registry import known_methods as known_methods
from .solvers.registry import register as register
from .solvers.backends.registry import get_backend as get_backend
from .solvers.backends.registry import installed_solvers as installed_solvers
from .solvers.batch import solve_many as solve_many
from .solvers.step import JointStep as JointStep
from .solvers.step import StepStatus as StepStatus
from .solvers.certificate import Certificate as Certificate
from .solvers.certificate import certify as certify
from .solvers.explain import explain as explain

# motion
from .motion import Motion as Motion
from .motion import solve_step as solve_step
from .reaching import Ending as Ending
from .reaching import Reached as Reached
from .reaching import reach as reach

# scenes
from .scene.entries import LimitEntry as LimitEntry
from .scene.entries import TaskEntry as TaskEntry
from .scene.scene import Scene as Scene
from .scene.scene import SceneRun as SceneRun
from .scene.scene import SceneStep as SceneStep
from .scene.task_file import load_scene as load_scene

# winding
from .winding.settings import WindingSettings as WindingSettings
from .winding.episode import Episode as Episode
from .winding.episode import wind as wind
from .winding.metrics import measure as measure
from .winding.own_robot import RobotWinding as RobotWinding
from .winding.own_robot import WoundRobot as WoundRobot
from .winding.own_robot import wind_robot as wind_robot
from .winding.own_robot import measure_robot as measure_robot

# errors
from .errors import PrioritizedIkError as PrioritizedIkError
from .errors import InputError as InputError
from .errors import SolverUnavailableError as SolverUnavailableError
from .errors import InfeasibleError as InfeasibleError
from .errors import StepNotFoundError as StepNotFoundError

__version__: str
