"""Tasks and limits as a task file has them: a kind, and the arguments of its class."""

import inspect
import typing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType, UnionType
from typing import Any

from prioritized_ik.collision import Collision
from prioritized_ik.errors import InputError, SolverUnavailableError
from prioritized_ik.guard import Limit
from prioritized_ik.joint_limits import Acceleration, JointRange, Velocity
from prioritized_ik.model_equalities import ModelEqualities
from prioritized_ik.robot import Frame, Robot
from prioritized_ik.support import SupportPolygon
from prioritized_ik.tasks.arms import VirtualArmsTask
from prioritized_ik.tasks.axis import Axis, LookAt
from prioritized_ik.tasks.centre_of_mass import CentreOfMass
from prioritized_ik.tasks.damping import Damping
from prioritized_ik.tasks.joint_coupling import JointCoupling
from prioritized_ik.tasks.orientation import Orientation
from prioritized_ik.tasks.pose import Pose
from prioritized_ik.tasks.position import Position
from prioritized_ik.tasks.posture import Posture
from prioritized_ik.tasks.task import Task
from prioritized_ik.validation import at_least, nearest_first, non_negative
from prioritized_ik.virtual_arms import VirtualArms

#: Kinds of tasks by what a file calls them. Their keys are the arguments of the class.
TASKS: dict[str, type[Task]] = {
    "position": Position,
    "orientation": Orientation,
    "pose": Pose,
    "axis": Axis,
    "look-at": LookAt,
    "centre-of-mass": CentreOfMass,
    "posture": Posture,
    "joint-coupling": JointCoupling,
    "damping": Damping,
    "virtual-arms": VirtualArmsTask,
}

#: Kinds of limits, likewise.
LIMITS: dict[str, type[Limit]] = {
    "joint-range": JointRange,
    "velocity": Velocity,
    "acceleration": Acceleration,
    "collision": Collision,
    "support-polygon": SupportPolygon,
    "model-equalities": ModelEqualities,
}


def _frame(
    robot: Robot, *, body: str | int | None = None, site: str | int | None = None, geom: str | int | None = None
) -> Frame:
    return robot.frame(body=body, site=site, geom=geom)


def _virtual_arms(robot: Robot, *, points: Sequence[str], axes: str = "xyz") -> VirtualArms:
    return VirtualArms(robot.model, points, axes)


#: Arguments of these types are tables in a file, whose keys are the arguments of what makes them of a robot.
OBJECTS: dict[type, Callable[..., object]] = {Frame: _frame, VirtualArms: _virtual_arms}

TARGET, WAY_POINTS = "target", ("times", "targets")


@dataclass
class AimedTask:
    """A task whose target moves: its way points `targets`, as the task has them, at `times` [s]."""

    task: Task
    times: tuple[float, ...]
    targets: tuple[Any, ...]

    def aim(self, time: float) -> None:
        """Set the target to what it is at a `time` [s]."""
        if self.times:
            task: Any = self.task  # not every task has a target
            task.target = self._at(time)

    def _at(self, time: float) -> Any:
        after = sum(point <= time for point in self.times)  # way points that are passed
        if after in (0, len(self.times)):
            return self.targets[max(after - 1, 0)]
        before, then = self.times[after - 1], self.times[after]
        return self.task.between(self.targets[after - 1], self.targets[after], (time - before) / (then - before))


@dataclass(frozen=True)
class TaskEntry:
    """A task.

    Attributes:
        kind: a key of `TASKS`.
        level: number of its level, from 1, the most important.
        arguments: of the task's class, `robot` aside.
        times: of way points, rising [s]; empty if the target rests.
        targets: one for each of them. Between two the target moves evenly, before and after all it rests.

    Raises:
        InputError: an unknown kind or argument, one that is missing, a level below 1, way points that do not fit.
    """

    kind: str
    level: int = 1
    arguments: Mapping[str, Any] = field(default_factory=dict)
    times: Sequence[float] = ()
    targets: Sequence[Any] = ()

    def __post_init__(self) -> None:
        allowed = arguments_of(TASKS[known_kind(self.kind, TASKS)])
        at_least("level", self.level, 1)
        moving = WAY_POINTS if TARGET in allowed else ()
        check_keys(self.arguments, [*allowed], ["kind", "level", *allowed, *moving])
        times, targets = _list("times", self.times), _list("targets", self.targets)
        if (times or targets) and not moving:
            raise InputError(f"a task of the kind {self.kind!r} has no target; leave out {' and '.join(WAY_POINTS)}.")
        if len(times) != len(targets):
            raise InputError(f"times has {len(times)} and targets {len(targets)} entries; expected as many of both.")
        if times and TARGET in self.arguments:
            raise InputError("target and targets are both given; expected one, or way points with times.")
        times = tuple(non_negative(f"times[{number}]", time) for number, time in enumerate(times))
        if any(second <= first for first, second in pairwise(times)):
            raise InputError(f"times is {list(times)}; expected seconds that rise.")
        check_complete({*self.arguments, *([TARGET] if times else [])}, TASKS[self.kind])
        object.__setattr__(self, "arguments", MappingProxyType(dict(self.arguments)))
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "targets", targets)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make it again: a read-only mapping does not pickle."""
        return type(self), (self.kind, self.level, dict(self.arguments), self.times, self.targets)

    def made(self, robot: Robot) -> AimedTask:
        """Return the task of a robot where it is.

        Raises:
            InputError: an argument that the task refuses.
        """
        first = {TARGET: self.targets[0]} if self.times else {}
        task: Any = TASKS[self.kind](robot, **_made(TASKS[self.kind], robot, self.arguments), **first)
        targets = []
        for number, target in enumerate(self.targets):
            with placed(f"targets[{number}]"):
                task.target = target
            targets.append(task.target)
        if self.times:
            task.target = targets[0]
        return AimedTask(task, tuple(self.times), tuple(targets))


@dataclass(frozen=True)
class LimitEntry:
    """A limit.

    Attributes:
        kind: a key of `LIMITS`.
        arguments: of the limit's class, `robot` aside.

    Raises:
        InputError: an unknown kind or argument, or one that is missing.
    """

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        allowed = arguments_of(LIMITS[known_kind(self.kind, LIMITS)])
        check_keys(self.arguments, [*allowed], ["kind", *allowed])
        check_complete(self.arguments, LIMITS[self.kind])
        object.__setattr__(self, "arguments", MappingProxyType(dict(self.arguments)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make it again: a read-only mapping does not pickle."""
        return type(self), (self.kind, dict(self.arguments))

    def made(self, robot: Robot) -> Limit:
        """Return the limit of a robot.

        Raises:
            InputError: an argument that the limit refuses.
        """
        return LIMITS[self.kind](robot, **_made(LIMITS[self.kind], robot, self.arguments))


def _made(kind: type[Task | Limit], robot: Robot, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a class, tables made the `OBJECTS` that it takes."""
    parameters, made = inspect.signature(kind).parameters, dict(arguments)
    for name, value in arguments.items():
        for make, several in _makers(parameters[name].annotation):
            with placed(name):
                made[name] = _objects(make, robot, value) if several else _object(make, robot, value)
    return made


def _makers(annotation: object) -> Iterator[tuple[Callable[..., object], bool]]:
    """Yield what makes the `OBJECTS` of an annotation, and whether it takes a sequence of them."""
    options = typing.get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    for option in options:
        several = typing.get_origin(option) is Sequence
        (kind,) = typing.get_args(option)[:1] if several else (option,)
        if kind in OBJECTS:
            yield OBJECTS[kind], several


def _objects(make: Callable[..., object], robot: Robot, tables: object) -> list[object]:
    if not isinstance(tables, Sequence) or isinstance(tables, str):
        raise InputError(f"expected a list of tables with some of: {', '.join(arguments_of(make))}; it is {tables!r}.")
    return [_object(make, robot, table) for table in tables]


def _object(make: Callable[..., object], robot: Robot, table: object) -> object:
    allowed = [*arguments_of(make)]
    if not isinstance(table, Mapping):
        raise InputError(f"expected a table with some of: {', '.join(allowed)}; it is {table!r}.")
    check_keys(table, allowed)
    check_complete(table, make)
    return make(robot, **table)


def arguments_of(kind: Callable[..., object]) -> dict[str, bool]:
    """Return the arguments of a class or function by name, the first, `robot`, aside, and whether each must be given."""
    parameters = list(inspect.signature(kind).parameters.values())[1:]
    return {parameter.name: parameter.default is parameter.empty for parameter in parameters}


def known_kind(kind: object, kinds: Mapping[str, object]) -> str:
    """Return `kind` if it is one of `kinds`.

    Raises:
        InputError: it is not; the message lists them, the nearest first.
    """
    if not isinstance(kind, str) or kind not in kinds:
        what = "there is no kind" if kind is None else f"unknown kind {kind!r}"
        raise InputError(f"{what}; choose one of: {', '.join(nearest_first(str(kind), list(kinds)))}.")
    return kind


def check_keys(keys: Mapping[str, object], allowed: Sequence[str], listed: Sequence[str] = ()) -> None:
    """Return if all `keys` are `allowed`.

    Raises:
        InputError: one is not; the message lists those that are, or `listed`, the nearest first.
    """
    for key in keys:
        if key not in allowed:
            raise InputError(f"unknown key {key!r}; expected some of: {', '.join(nearest_first(key, listed or allowed))}.")


def check_complete(given: Collection[str], kind: Callable[..., object]) -> None:
    """Return if all arguments are `given` that a class or function must have.

    Raises:
        InputError: one is missing.
    """
    for name, needed in arguments_of(kind).items():
        if needed and name not in given:
            raise InputError(f"there is no {name}; expected one.")


@contextmanager
def placed(place: str) -> Iterator[None]:
    """Say of every bad value and solver inside in which `place` it is.

    Raises:
        InputError: as inside, the message led by the place.
        SolverUnavailableError: likewise.
    """
    try:
        yield
    except (InputError, SolverUnavailableError) as error:
        raise type(error)(f"{place}: {error}") from error


def _list(name: str, value: object) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise InputError(f"{name} is {value!r}; expected a list.")
    return tuple(value)
