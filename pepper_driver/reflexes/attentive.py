"""Watch over an attentive robot: joints that are hot or soft stop to oscillate, and what hides touches is said once."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.dither import Dither
from pepper_driver.observer.interface import MIN_OBSERVED_STIFFNESS

COOLED = 3.0
"""[K] By which a motor must have cooled below its limit before its joint oscillates again."""

CHECK_TIME = 0.5
"""[s] Between two checks of temperatures and stiffness: joints fade out within seconds."""

MIN_SLIDE_RATIO = 0.5
"""Of the slide that is meant, from peak to peak: a joint that moves less has more friction than was identified."""

STUCK_PERIODS = 3
"""Periods in a row that a joint must hardly move before it is said: a hand may hold it for one."""

SHIFTED = np.radians(0.3)
"""[rad] Distance from the posture that is worth saying."""

logger = logging.getLogger("pepper_driver")


@dataclass(frozen=True, kw_only=True)
class AttentiveNote:
    """Something that limits how attentive a joint is, or does no longer."""

    joint: str
    text: str


class AttentiveWatch:
    """Decides which joints are withheld from oscillating, and finds those that do not slide.

    A joint is withheld while its motor is hot, or while its stiffness is lowered so far that no observer judges it.

    Args:
        robot: Its description.
        dither: The oscillation, whose ``withheld`` this sets.
    """

    def __init__(self, robot: RobotConfig, dither: Dither) -> None:
        self._names, self._dither = robot.joint_names, dither
        self._check_ticks = round(CHECK_TIME / robot.cycle)
        self._period_ticks = round(dither.settings.period / robot.cycle)
        self.reset()

    def reset(self) -> None:
        """Forget what was said."""
        count = len(self._names)
        self._said: set[tuple[str, str]] = set()
        self._hot, self._soft = np.zeros((2, count), dtype=np.bool_)
        self._until_check = 0
        self._stuck_periods = np.zeros(count, dtype=np.int64)
        self._dither.withheld = self._hot
        self._begin_period()

    def _begin_period(self) -> None:
        self._ticks, count = 0, len(self._names)
        self._low, self._high = np.full(count, np.inf), np.full(count, -np.inf)
        self._full: BoolArray = np.ones(count, dtype=np.bool_)

    @property
    def withheld(self) -> tuple[str, ...]:
        """Joints that do not oscillate though they would."""
        still = self._dither.withheld & (self._dither.amplitude > 0.0)
        return tuple(self._names[joint] for joint in np.flatnonzero(still))

    def step(self, measurement: Measurement, stiffness: FloatArray) -> list[AttentiveNote]:
        """Take in one tick of an attentive robot; return what is new, which is also warned of once.

        Args:
            measurement: The newest.
            stiffness: (17,) of the motors that is requested, 0..1.
        """
        notes: list[AttentiveNote] = []
        self._until_check -= 1
        if self._until_check < 0:
            self._until_check = self._check_ticks
            self._withhold(measurement.temperature, stiffness, notes)
        self._low = np.fmin(self._low, measurement.position)
        self._high = np.fmax(self._high, measurement.position)
        self._full &= self._dither.full
        self._ticks += 1
        if self._ticks >= self._period_ticks:
            self._judge_period(notes)
            self._begin_period()
        return notes

    def _withhold(
        self, temperature: FloatArray, stiffness: FloatArray, notes: list[AttentiveNote]
    ) -> None:
        limit, used = self._dither.settings.max_temperature, self._dither.amplitude > 0.0
        warm = temperature >= np.where(self._hot, limit - COOLED, limit)
        # A temperature that is unknown changes nothing: the safety gate warns of it.
        hot = used & np.where(np.isnan(temperature), self._hot, warm)
        soft = used & (stiffness < MIN_OBSERVED_STIFFNESS)
        for joint in np.flatnonzero(hot & ~self._hot).tolist():
            self._say(
                joint,
                f"its motor has {temperature[joint]:.0f} deg C: it does not oscillate before it has cooled below "
                f"{limit - COOLED:.0f}",
                notes,
                "hot",
            )
        for joint in np.flatnonzero(soft & ~self._soft).tolist():
            text = "its stiffness is lowered: it does not oscillate, and detects nothing meanwhile"
            self._say(joint, text, notes, "soft")
        before, now = self._hot | self._soft, hot | soft
        for joint in np.flatnonzero(before & ~now).tolist():
            notes.append(AttentiveNote(joint=self._names[joint], text="it oscillates again"))
        self._hot, self._soft = hot, soft
        self._dither.withheld = now

    def _judge_period(self, notes: list[AttentiveNote]) -> None:
        meant = 2.0 * np.radians(self._dither.settings.slide_deg)
        moved = self._high - self._low
        stuck = self._full & (moved < MIN_SLIDE_RATIO * meant)
        self._stuck_periods = np.where(stuck, self._stuck_periods + 1, 0)
        for joint in np.flatnonzero(self._stuck_periods == STUCK_PERIODS).tolist():
            self._say(
                joint,
                f"it hardly moves, by {np.degrees(moved[joint]):.1f} of {np.degrees(meant):.1f} deg: it has more "
                "friction than was identified, or a limit or a hand holds it, and light touches are hidden",
                notes,
                "stuck",
            )
        shift = self._dither.centre
        for joint in np.flatnonzero(self._full & (np.abs(shift) > SHIFTED)).tolist():
            if (self._names[joint], "shifted") not in self._said:
                degrees = np.degrees(abs(shift[joint]))
                text = f"it is near its limit: it oscillates {degrees:.1f} deg inside of its target"
                self._say(joint, text, notes, "shifted", warn=False)

    def _say(
        self, joint: int, text: str, notes: list[AttentiveNote], reason: str, *, warn: bool = True
    ) -> None:
        name = self._names[joint]
        if warn and (name, reason) not in self._said:
            logger.warning("attentive robot, %s: %s", name, text)
        self._said.add((name, reason))
        notes.append(AttentiveNote(joint=name, text=text))
