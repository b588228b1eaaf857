"""Labels of touches: made during a run from a key, a touch sensor or a bumper; read from a log for scoring."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.backends.fields import RECORDED_FIELDS
from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.robot import TRUNK
from pepper_driver.config.touch_prompts import TouchPrompts
from pepper_driver.log import Label, RunLog
from pepper_driver.log.topics import LabelPhase
from pepper_driver.observer import KnownPush, Recording, RecordingError
from pepper_driver.recording.terminal_keys import SpaceBar

logger = logging.getLogger("pepper_driver")


class LabelError(PepperError, ValueError):
    """Touches cannot be labelled this way, or a log does not say what was touched when."""


@checked_arguments
def recording_of(log: RunLog, robot: RobotConfig) -> Recording:
    """Return the recording that a log holds; ticks that repeat a cycle of the robot are left out.

    Raises:
        RecordingError: Another robot, fewer than two ticks, a value that is not finite.
    """
    if log.joint_names != robot.joint_names:
        raise RecordingError(
            f"this log is of a robot with other joints, or another order of them, than '{robot.name}'"
        )
    continues = np.diff(log["time"], prepend=-np.inf) != 0
    columns = {field.column: log[field.name][continues] for field in RECORDED_FIELDS}
    return Recording(joint_names=log.joint_names, **columns)


@checked_arguments
def pushes_of(
    log: RunLog, *, link: str | None = None, joint: str | None = None
) -> tuple[KnownPush, ...]:
    """Return the touches of a log's labels. The direction is not known: 0; nor is the force unless a label has it: NaN.

    A touch that was not released counts until the end of the log, a release without an onset not at all; both are
    warned of.

    Args:
        log: Of ``pepper record``.
        link: What was touched, for labels that do not say so.
        joint: The last joint that moves it; None on trunk and base.

    Raises:
        LabelError: There is no label of a touch, or the touched link is unknown.
    """
    spans, open_label = [], None
    for label in log.labels:
        if (label.phase == "onset") == (open_label is None):
            if open_label is not None:
                spans.append((open_label, label.time))
            open_label = label if label.phase == "onset" else None
        else:
            what = "onset inside a touch" if open_label is not None else "release without an onset"
            logger.warning("label at %.3f s: %s, left out", label.time, what)
    if open_label is not None:
        end = float(log["time"][-1]) if len(log) else open_label.time
        logger.warning(
            "label at %.3f s: the touch was not released, it counts until the end of the log",
            open_label.time,
        )
        spans.append((open_label, end))
    if not spans:
        raise LabelError("this log has no labelled touch; make one with 'pepper record --label'")
    return tuple(_push(onset, release, link, joint) for onset, release in spans)


def _push(onset: Label, release: float, link: str | None, joint: str | None) -> KnownPush:
    if onset.link is not None:
        link, joint = onset.link, onset.joint
    if link is None:
        raise LabelError(
            f"the label at {onset.time:.3f} s does not say what was touched; record with --link"
        )
    return KnownPush(
        joint=joint,
        link=link,
        direction=0,
        force=math.nan if onset.force is None else onset.force,
        torque=math.nan,
        degrees=math.nan,
        onset=onset.time,
        release=release,
        moving=False,
    )


LabelSource = Literal["key", "head", "hand-left", "hand-right", "bumper"]

_TOUCH = {"head": "Head/", "hand-left": "LHand/", "hand-right": "RHand/"}
"""Beginning of the names of the touch sensors that count."""

Pressed = Callable[[Measurement], bool]


class Labeller:
    """Makes labels of the edges of something that is pressed or not.

    A sensor that is pressed already in the first tick began at an unknown time: it is left out until it is released.

    Args:
        source: What is pressed.
        pressed: Whether it is, given a measurement.
        link: The touched link; None if unknown.
        joint: The last joint of its chain that moves the link; None on trunk and base.
        force: Of a touch with a spring scale [N]; None if unknown.
    """

    def __init__(
        self,
        source: LabelSource,
        pressed: Pressed,
        link: str | None,
        joint: str | None,
        force: float | None = None,
    ) -> None:
        self._source, self._pressed = source, pressed
        self._link, self._joint, self._force = link, joint, force
        self._ready = source == "key"
        self._touched = False

    @property
    def touched(self) -> bool:
        """True if the last label was an onset."""
        return self._touched

    def step(self, measurement: Measurement) -> tuple[Label, ...]:
        """Return the label of this tick, if there is one."""
        pressed = self._pressed(measurement)
        self._ready = self._ready or not pressed
        if not self._ready or pressed == self._touched:
            return ()
        self._touched = pressed
        return (self._label(float(measurement.time), "onset" if pressed else "release"),)

    def _label(self, time: float, phase: LabelPhase) -> Label:
        return Label(
            time=time,
            phase=phase,
            source=self._source,
            link=self._link,
            joint=self._joint,
            force=self._force,
        )


class PromptedLabeller:
    """Makes labels of touches that prompts ask for, one after the other, each of its own place and force.

    A touch that lasts into the next prompt keeps its place. Time is counted in ticks, as the player counts it: where
    ticks are missed, both are late together.

    Args:
        source: What is pressed; see :func:`make_labeller`.
        prompts: With their times, which begin with the first tick.
        robot: Its description.
        space_bar: What the source ``key`` is.
    """

    def __init__(
        self, source: str, prompts: TouchPrompts, robot: RobotConfig, space_bar: SpaceBar
    ) -> None:
        self._labellers = [
            make_labeller(source, robot, space_bar, link=touch.link, force=touch.force)
            for touch in prompts.touches
        ]
        self._rest, self._period = (
            round(time / robot.cycle) for time in (prompts.rest, prompts.time)
        )
        self._ticks = -1
        self._number = 0

    @property
    def touched(self) -> bool:
        """True if the last label was an onset."""
        return self._labellers[self._number].touched

    @property
    def asked(self) -> int | None:
        """Number of the prompt whose time it is; None before the first and after the last."""
        number = (self._ticks - self._rest) // self._period
        return number if 0 <= number < len(self._labellers) else None

    def step(self, measurement: Measurement) -> tuple[Label, ...]:
        """Return the label of this tick, if there is one."""
        self._ticks += 1
        if self.asked is not None and not self.touched:
            self._number = self.asked
        return self._labellers[self._number].step(measurement)


def make_labeller(
    source: str,
    robot: RobotConfig,
    space_bar: SpaceBar,
    *,
    link: str | None = None,
    joint: str | None = None,
    force: float | None = None,
) -> Labeller:
    """Return a labeller of a source.

    Args:
        source: One of ``LabelSource``.
        robot: Its description.
        space_bar: What the source ``key`` is.
        link: What is touched; by default the link of the sensor, and unknown for a key.
        joint: The last joint that moves the link; by default the one that carries it.
        force: Of a touch with a spring scale [N]; None if unknown.

    Raises:
        UnknownNameError: No such source, link or joint.
        LabelError: The robot has no such sensor.
    """
    name = next((name for name in get_args(LabelSource) if name == source), None)
    if name is None:
        raise UnknownNameError("label", source, get_args(LabelSource))
    if name == "key":
        return Labeller(name, lambda _: space_bar.on, *_place(robot, link, joint), force)
    sensors = robot.sensors.bumpers if name == "bumper" else robot.sensors.touch
    beginning = _TOUCH.get(name, "")
    places = [k for k, sensor in enumerate(sensors) if sensor.startswith(beginning)]
    if not places:
        raise LabelError(f"'{robot.name}' has no sensor for the label '{name}'")
    if link is None and joint is None:
        link = list(sensors.values())[places[0]].parent

    def pressed(measurement: Measurement) -> bool:
        values = measurement.bumpers if name == "bumper" else measurement.touch
        return bool(values[places].any())

    return Labeller(name, pressed, *_place(robot, link, joint), force)


def _place(
    robot: RobotConfig, link: str | None, joint: str | None
) -> tuple[str | None, str | None]:
    """Link and joint of a touch, of which one or both may be given; no joint on trunk and base."""
    if link is not None and link not in robot.links:
        raise UnknownNameError("link", link, robot.links)
    if joint is not None:
        child = robot.joints[robot.joint_index(joint)].child
        link = child if link is None else link
    elif link is not None:
        joint = next((j.name for j in robot.joints if j.child == link), None)
    return link, None if robot.limb_of(joint) == TRUNK else joint
