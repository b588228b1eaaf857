"""True pushes of a simulated run that no one planned or labelled, from the ground truth in its log."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pepper_driver.backends.fields import Column
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.robot import LEGS, TRUNK
from pepper_driver.evaluation.episodes import as_it_was
from pepper_driver.experiments.push_planning import HELD_BY_FRICTION
from pepper_driver.identification.quality import AT_REST
from pepper_driver.log import RunLog
from pepper_driver.log.topics import TrueForce
from pepper_driver.log.touches import PUSHED, touches
from pepper_driver.observer import KnownPush
from pepper_driver.recording.labels import LabelError

DISTAL_RATIO = 0.25
"""Equivalent degrees on a joint, as a ratio to the most on any joint of its limb, up to which it is not the joint that
is pushed; pushes of the frozen suites are planned by this."""


@dataclass(frozen=True, kw_only=True)
class LoggedPlant:
    """Plant of a simulated run, as its log describes it; NaN where that part of the log is damaged.

    Attributes:
        stiffness: (N,) K = kp N Kt / R [N m/rad].
        friction: (N,) largest torque that friction holds at rest [N m].
    """

    stiffness: FloatArray
    friction: FloatArray

    @classmethod
    def of(cls, log: RunLog) -> Self:
        """Read it from the metadata of a run.

        Raises:
            LabelError: They hold no such numbers.
        """
        shape = (len(log.joint_names),)
        if "plant" not in log.metadata:
            return cls(stiffness=np.full(shape, math.nan), friction=np.full(shape, math.nan))
        try:
            known = json.loads(log.metadata["plant"])
            stiffness, friction = (
                np.array(known[name], dtype=np.float64) for name in ("stiffness", "friction")
            )
        except (ValueError, TypeError, KeyError) as error:
            raise LabelError(f"'plant' in the metadata of this log is damaged ({error})") from error
        if not stiffness.shape == friction.shape == shape:
            raise LabelError("'plant' in the metadata of this log is not that of its joints")
        return cls(stiffness=stiffness, friction=friction)


def true_pushes(log: RunLog, robot: RobotConfig) -> tuple[KnownPush, ...]:
    """Return what really touched a simulated robot, in the order of onset; sizes are those that really acted.

    - What a push or a hand does to one link is one push, with pauses up to PUSH_PAUSE. What an object of the world does
      to the links of one limb is one push too, on the link that it loads most.
    - Its onset is the begin of the first cycle in which a force acts, its release the end of the last one. A force that
      acts from before the log counts from its begin, one that still acts at its end until there.
    - Its joint is the last of the limb that it turns: with more than DISTAL_RATIO of the equivalent degrees on any
      joint from the trunk to the link, and more than friction holds. None on trunk and base.
    - Torques are those of all forces together, as in the truth.

    Raises:
        LabelError: The log has no true forces.
    """
    truth = log.truth
    if truth is None or log.forces is None:
        raise LabelError(
            "this log has no labelled touch, and its version did not log true forces; record the run again"
        )
    time, plant = truth["time"], LoggedPlant.of(log)
    pushes = []
    for forces in _by_touched(log.forces, time, robot).values():
        rows = np.searchsorted(time, [force.time for force in forces])
        touched = np.zeros(len(time), dtype=np.bool_)
        touched[rows] = True
        for first, last in touches(time, touched):
            own = [f for f, row in zip(forces, rows, strict=True) if first <= row <= last]
            pushes.append(_push(log, truth, plant, own, first, last, robot))
    return tuple(sorted(pushes, key=lambda push: push.onset))


def _by_touched(
    forces: Sequence[TrueForce], time: FloatArray, robot: RobotConfig
) -> dict[tuple[str | None, str], list[TrueForce]]:
    """Return the forces that count by what they touch: a link, or an object and a limb."""
    known = set(time.tolist())  # a damaged log may have lost the truth of a cycle
    grouped: dict[tuple[str | None, str], list[TrueForce]] = {}
    for force in forces:
        if force.peak > PUSHED and force.time in known:
            place = force.link if force.object is None else robot.limb_of_link(force.link)
            grouped.setdefault((force.object, place), []).append(force)
    return grouped


def _push(
    log: RunLog,
    truth: Mapping[str, Column],
    plant: LoggedPlant,
    forces: Sequence[TrueForce],
    first: int,
    last: int,
    robot: RobotConfig,
) -> KnownPush:
    """Return the push of some forces, in rows of the truth."""
    onset, release = float(truth["time"][first]) - robot.cycle, float(truth["time"][last])
    torque = truth["contact_torque"]
    load: dict[str, float] = {}
    for force in forces:
        load[force.link] = load.get(force.link, 0.0) + force.peak
    link = max(load, key=load.__getitem__)
    largest = np.abs(torque[first : last + 1]).max(axis=0)
    joint = pushed_joint(robot, link, largest, plant)
    joints = [
        robot.joint_index(name) for name in (robot.chains[LEGS] if joint is None else (joint,))
    ]
    saturated = truth["saturated"][first : last + 1, joints]
    push = KnownPush(
        joint=joint,
        link=link,
        direction=0,
        force=max(force.peak for force in forces),
        torque=math.nan,
        degrees=math.nan,
        onset=onset,
        release=release,
        moving=_moves(log, joint, onset),
        saturated=bool(saturated.any()),
    )
    if joint is not None:
        return as_it_was(push, truth["time"], torque, plant.stiffness, robot)
    index = joints[int((largest[joints] / plant.stiffness[joints]).argmax())]
    # Of trunk and base the leg joint with the most degrees counts.
    return replace(
        as_it_was(
            replace(push, joint=robot.joint_names[index]),
            truth["time"],
            torque,
            plant.stiffness,
            robot,
        ),
        joint=None,
    )


def pushed_joint(
    robot: RobotConfig, link: str, torque: FloatArray, plant: LoggedPlant
) -> str | None:
    """Return the last joint that a touch of a link turns, None on trunk and base.

    Args:
        robot: Description of the robot.
        link: What is touched.
        torque: (N,) size of the largest torque on each joint [N m].
        plant: Of the robot.
    """
    carrier = next((joint.name for joint in robot.joints if joint.child == link), None)
    if carrier is None or robot.limb_of(carrier) == TRUNK:
        return None
    chain = robot.chain_of(carrier)
    chain = chain[: chain.index(carrier) + 1]
    joints = [robot.joint_index(name) for name in chain]
    size = torque[joints] / plant.stiffness[joints]
    if not size.max() > 0.0:  # nothing is turned, or nothing is known of it
        return carrier
    turned = (size > DISTAL_RATIO * size.max()) & (
        torque[joints] > HELD_BY_FRICTION * plant.friction[joints]
    )
    return chain[int(np.flatnonzero(turned)[-1])] if turned.any() else chain[int(size.argmax())]


def _moves(log: RunLog, joint: str | None, onset: float) -> bool:
    """Return True where a joint was commanded to move at a time [s], any for None."""
    row = min(int(np.searchsorted(log["time"], onset)), len(log) - 1)
    speed = np.abs(log["reference_velocity"][row])
    return bool((speed if joint is None else speed[log.joint_names.index(joint)]).max() > AT_REST)
