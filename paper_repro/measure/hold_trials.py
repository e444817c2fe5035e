"""Trials of a hold, by each of three controls: with gravity and without, and where friction or torques no longer do."""

from dataclasses import asdict, replace
from typing import Any

from paper_repro.measure.holding import HOLDS, JOINT_SPACE, TASK_SPACE, Control, Hold, Scene, Trial, hold
from paper_repro.measure.torque_hierarchy import HierarchyHold

HIERARCHY = "torque hierarchy"
CONTROLS = (JOINT_SPACE, TASK_SPACE, HIERARCHY)

#: What is tried, in rising order; where it fails is sought by halving, which takes for granted that more holds better.
FRICTIONS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
TORQUES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # [N m]


def held(wound: str, direction: str, control: str, sought: bool) -> dict[str, Any]:
    """Return the fields of `Hold` with gravity and, under `weightless`, without; and `ends` of the links then `(n, 3)` [m].

    Under `friction` and `torque_limit`, if they are `sought`, the largest value tried that fails and the smallest that
    holds, each None if there is none.
    """
    trial = Trial(wound, direction)
    found = {**asdict(tried(trial, control)), "ends": Scene(trial).ends.tolist()}
    found["weightless"] = asdict(tried(replace(trial, gravity=0.0), control))
    for name, values in (("friction", FRICTIONS), ("torque_limit", TORQUES)):
        found[name] = _bracket(trial, control, name, values, found["held"]) if sought else (None, None)
    return found


def tried(trial: Trial, control: str) -> Hold:
    """Return how one of `CONTROLS` holds."""
    scene = Scene(trial)
    holds: Control = HierarchyHold(scene, trial) if control == HIERARCHY else HOLDS[control](scene)
    return hold(trial, scene, holds)


def _bracket(
    trial: Trial, control: str, name: str, values: tuple[float, ...], holds: bool
) -> tuple[float | None, float | None]:
    """Return the neighbours among `values` between which it fails and holds, given whether it holds at the trial's own."""
    own = values.index(getattr(trial, name))
    low, high = (-1, own) if holds else (own, len(values))
    while high - low > 1:
        middle = (low + high) // 2
        changes: dict[str, Any] = {name: values[middle]}
        if tried(replace(trial, **changes), control).held:
            high = middle
        else:
            low = middle
    return (values[low] if low >= 0 else None), (values[high] if high < len(values) else None)
