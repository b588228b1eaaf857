"""Records of the judge of touch, made by hand or drawn from known curves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from pepper_driver.config.touch_suites import EVEN
from pepper_driver.evaluation.touch.records import (
    BoardLaw,
    ObserverRecord,
    ReportedEvent,
    RobotRecord,
    Take,
    TorqueEstimate,
    Touched,
)
from pepper_driver.evaluation.touch.summary_data import ObserverSummary, TouchSummary

OURS = "fusion"
"""Name of the observer of the project."""
FORCES = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0)
LINKS = {
    "hand": ("left_arm", "l_wrist"),
    "forearm": ("left_arm", "LForeArm"),
    "upper arm": ("left_arm", "LBicep"),
    "shoulder": ("left_arm", "LBicep"),
    "head": ("head", "Head"),
    "trunk": ("trunk", "torso"),
    "hip": ("trunk", "Hip"),
    "base": ("trunk", "Tibia"),
}
"""By place of the suites, limb and link."""
TORQUES = {
    "left_arm": {"LShoulderRoll": 2.0, "LElbowRoll": 1.5, "LWristYaw": 0.1},
    "head": {"HeadYaw": 0.2, "HeadPitch": 1.0},
    "trunk": {"HipPitch": 3.0},
}
"""By limb, what a touch does to its joints [N m]."""


def touched(
    onset: float, place: str = "hand", asked: float | None = 8.0, **changes: Any
) -> Touched:
    """A touch of one second."""
    limb, link = LINKS[place]
    values: dict[str, Any] = {
        "row": EVEN,
        "place": place,
        "limb": limb,
        "link": link,
        "asked": asked,
        "force": asked,
        "rise": 0.1,
        "onset": onset,
        "release": onset + 1.0,
        "torque": TORQUES[limb],
        "friction_bound": 6.0,
        "moving": False,
    }
    return Touched(**{**values, **changes})


def reported(
    number: int, begin: float, end: float | None, limb: str = "left_arm", **changes: Any
) -> Iterator[ReportedEvent]:
    """Begin and end of a contact; it names, and is shown by, the joint that touches of the limb turn most."""
    torques = TORQUES.get(limb, {"RElbowRoll": 1.0})
    joint = None if limb == "trunk" else max(torques, key=torques.__getitem__)
    values: dict[str, Any] = {"kind": "contact", "joint": joint, "direction": 1, **changes}
    values.setdefault("shown_by", values["joint"])
    yield ReportedEvent(id=number, phase="begin", time=begin, limb=limb, **values)
    if end is not None:
        yield ReportedEvent(id=number, phase="end", time=end, limb=limb, **values)


def take(
    touches: Sequence[Touched] = (),
    hearings: Mapping[str, ObserverRecord] | None = None,
    *,
    suite: Literal["touch", "free"] = "touch",
    seconds: float = 3600.0,
    **changes: Any,
) -> Take:
    values: dict[str, Any] = {"state": "standing", "number": 0, "day": None, "seed": 7, **changes}
    return Take(
        suite=suite,
        start=0.0,
        end=seconds,
        touches=tuple(touches),
        hearings=dict(hearings or {}),
        **values,
    )


def robot(*takes: Take, name: str = "random 0", **changes: Any) -> RobotRecord:
    values: dict[str, Any] = {"law": "nominal", "draw": 0, "fit": {}, **changes}
    return RobotRecord(key="hand-made", robot=name, identity="hand-made", takes=takes, **values)


def drawn_robot(
    number: int,
    law: BoardLaw,
    middles: Mapping[str, Mapping[str, Mapping[str, float]]],
    *,
    false: Mapping[str, float] | None = None,
    slope: float = 0.25,
    forces: Sequence[float] = FORCES,
    rows: Mapping[str, Mapping[str, Any]] | None = None,
    free_hours: float = 0.5,
    spread: float = 0.1,
) -> RobotRecord:
    """A robot whose touches are detected with the probability of logistic curves in log force.

    Args:
        number: Of its draw, and seed.
        law: Of its boards.
        middles: By state, place and observer, force at which half of the touches are detected [N]; infinite for none.
        false: By observer, false contacts an hour.
        slope: Of the curves.
        forces: [N]
        rows: By name of another row, changes of a touch: it is made at each place with 12 N.
        free_hours: Length of the take without touches of each state [h].
        spread: Of the middles of robots in ln force.
    """
    rng = np.random.default_rng(number)
    own = math.exp(spread * rng.standard_normal())
    false = false or {}
    observers = list(dict.fromkeys(n for p in middles.values() for m in p.values() for n in m))
    takes = []
    for state, places in middles.items():
        touches = [
            touched(0.0, place, force, moving=state in ("gesturing", "whole-body"))
            for place in places
            for force in forces
        ]
        touches += [
            touched(0.0, place, **{"asked": 12.0, "row": row, **changes})
            for row, changes in (rows or {}).items()
            for place in places
        ]
        acted = [
            lasting(touch, 3.0 + 4.0 * place)
            for place, touch in enumerate(touches[i] for i in rng.permutation(len(touches)))
        ]
        seconds = 4.0 * len(acted) + 5.0
        hearings = {
            name: _drawn(acted, places, name, own, slope, rng, false.get(name, 0.0), seconds)
            for name in observers
        }
        takes.append(take(acted, hearings, state=state, seconds=seconds))
        if free_hours > 0.0:
            seconds = 3600.0 * free_hours
            hearings = {
                name: _drawn((), places, name, own, slope, rng, false.get(name, 0.0), seconds)
                for name in observers
            }
            takes.append(take((), hearings, state=state, suite="free", seconds=seconds))
    fit = {"LShoulderRoll": 90.0 + number, "HeadYaw": 96.0}
    return robot(*takes, name=f"random {number}", draw=number, law=law, fit=fit)


def lasting(touch: Touched, onset: float) -> Touched:
    """The touch at another time."""
    values = {name: getattr(touch, name) for name in touch.__dataclass_fields__}
    return Touched(**{**values, "onset": onset, "release": onset + touch.release - touch.onset})


def _drawn(
    touches: Sequence[Touched],
    places: Mapping[str, Mapping[str, float]],
    observer: str,
    own: float,
    slope: float,
    rng: np.random.Generator,
    false: float,
    seconds: float,
) -> ObserverRecord:
    events: list[ReportedEvent] = []
    torques = []
    for number, touch in enumerate(touches):
        middle = places[touch.place].get(observer, math.inf) * own
        force = touch.force or 0.0
        fraction = 1.0 / (1.0 + (middle / force) ** (1.0 / slope)) if middle < math.inf else 0.0
        if rng.random() < fraction:
            delay = float(rng.uniform(0.1, 0.25)) if touch.release - touch.onset > 0.3 else 0.1
            events += reported(
                number,
                touch.onset + delay,
                touch.release + float(rng.uniform(0.02, 0.2)),
                touch.limb,
            )
            torques += [
                TorqueEstimate(
                    touch=number, joint=joint, true=size, estimate=size + rng.normal(0.0, 0.3)
                )
                for joint, size in touch.torque.items()
                if size > 0.5
            ]
    joints = ("RElbowRoll", "RWristYaw", "RWristYaw", "RShoulderPitch", None)
    for number in range(rng.poisson(false * seconds / 3600.0)):
        time = float(rng.uniform(1.0, seconds - 3.0))
        joint = joints[int(rng.integers(len(joints)))]
        limb = "trunk" if joint is None else "right_arm"
        events += reported(1000 + number, time, time + 0.5, limb, joint=joint)
    events.sort(key=lambda event: event.time)
    return ObserverRecord(
        events=tuple(events),
        torques=tuple(torques),
        threshold_deg={"LShoulderRoll": float(rng.uniform(0.8, 1.2)), "HeadYaw": 1.5},
    )


def ours(summary: TouchSummary) -> ObserverSummary:
    """The results of the observer of the project."""
    observer = summary.observer(OURS)
    assert observer is not None
    return observer
