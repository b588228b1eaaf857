"""What the wheels should do in free motion, and how far they are from it: contacts on the base, and on a stiff trunk.

The wheels' speed controllers answer their set-points nearly linearly, and so does the base to the limbs that the robot
throws about: a finite impulse response from what was sent, and from the load on the legs, foretells the measured twist.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ConfigDict, Field

from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import STRICT
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.median import RunningMedian
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.strays import START, Strays

Triple = tuple[float, float, float]

TAPS = 25
"""Ticks of the impulse response: 0.3 s, by which the wheels have settled."""

ROWS = 10 * TAPS
"""Of the memory of inputs: it is moved once in nine responses."""

RIDGE = 1e-3  # of the mean square of the inputs

STANDING = 0.005
"""[m/s], [rad/s] A base that has been sent no faster for the length of the response stands."""

MARGIN = 2.6
"""Over the largest residual of the calibration."""

SAME_AXIS = 0.5
"""Share of the largest residual at which the axis that told before goes on to tell."""

HOLD = 0.3
"""[s] After the response to a drive, for which its bound stays."""


class BaseModelError(PepperError, ValueError):
    """Values that make no model."""


@dataclass(frozen=True, kw_only=True)
class BaseModel:
    """Of the base's twist: vx [m/s], vy [m/s], wz [rad/s].

    Attributes:
        coefficients: One row of three per input: first those of this tick, then of the one before, and so on.
        standing: Bounds of the residual while the base is told to stand.
        driving: While it is told to drive.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    coefficients: Annotated[tuple[Triple, ...], Field(min_length=1)]
    standing: Triple
    driving: Triple

    def __post_init__(self) -> None:
        if len(self.coefficients) % TAPS:
            raise BaseModelError(f"'coefficients' must be a multiple of {TAPS} rows")
        values = [*self.standing, *self.driving]
        if not (np.isfinite(self.coefficients).all() and np.isfinite(values).all()):
            raise BaseModelError("a value is not finite")
        if min(values) <= 0.0:
            raise BaseModelError("a bound must be above 0")


class BaseSignal:
    """Residual of the base, as a share of its bound: beyond 1 in size, something pushes.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        adapt: Whether to follow how far the base strays today, standing and driving.
    """

    def __init__(self, model: BaseModel, robot: RobotConfig, window: int, *, adapt: bool) -> None:
        response = np.array(model.coefficients).reshape(TAPS, -1, 3)
        # The load enters by its change over the response: the base feels accelerations, not weight.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response = response.reshape(-1, 3)
        self._inputs_per_tick = response.shape[1]
        self._standing, self._driving = np.array(model.standing), np.array(model.driving)
        self._legs = _legs(robot)
        self._inverse = np.asarray(robot.wheels.inverse)
        self._window, self._still = window, TAPS + round(HOLD / robot.cycle)
        self._adapt = adapt
        # Of the residual as a share of its bound: standing is the second.
        bound, start = np.ones(3), np.full(3, START)
        self._strays = (Strays(bound, start), Strays(bound, start))
        self._everything = np.ones(3, dtype=np.bool_)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        # The newest TAPS rows stand at `_newest`; it moves up, and back to the end when it has come to the top.
        self._inputs = np.zeros((ROWS, self._inputs_per_tick))
        self._newest = ROWS - TAPS
        self._median = RunningMedian(self._window, 3)
        self._count = 0
        self._standing_ticks = self._still
        self._blind = 0
        self._axis = 0
        for strays in self._strays:
            strays.reset()
        self._judged = False

    def step(self, tick: Tick, late: bool) -> tuple[float, float]:
        """Take in one tick; the residual before and after the filter, NaN while it cannot be judged.

        Args:
            tick: The cycle.
            late: Whether its sample is late: wheels tell their speed of now only.
        """
        inputs = self._remember(tick.sent.wheel_speed, tick.reference.load_torque)
        twist = self._inverse @ tick.measurement.wheel_speed
        seen = math.isfinite(twist[0] + twist[1] + twist[2])
        if late or self._count < TAPS or not seen:
            self._blind = self._window
        error = inputs.ravel() @ self._response - twist
        stands = self._standing_ticks >= self._still
        share = error / (self._standing if stands else self._driving)
        self._filtered = self._median.push(share if seen else np.zeros(3))
        self._judged = self._blind == 0
        if not self._judged:
            self._blind -= 1
            return np.nan, np.nan
        wider = self._strays[stands].factor if self._adapt else 1.0
        share, filtered = share / wider, self._filtered / wider
        size = np.abs(filtered)
        # An axis keeps telling while it tells nearly as much as any: its sign is that of the contact.
        if size[self._axis] < SAME_AXIS * size.max():
            self._axis = int(np.argmax(size))
        return float(share[self._axis]), float(filtered[self._axis])

    def learn(self, untouched: bool, moving: bool) -> None:
        """Take in what the last tick was: whether nothing touched the robot, and whether joints of it were to move."""
        stands = self._standing_ticks >= self._still
        if not untouched:
            for strays in self._strays:
                strays.touched()
        elif self._judged:
            moved = self._everything & (moving or not stands)
            self._strays[stands].learn(self._filtered, self._everything, moved)

    def _remember(self, wheel_speed: FloatArray, load_torque: FloatArray) -> FloatArray:
        """Take in what was sent and what the legs bear; the inputs of the response, newest first."""
        if self._newest == 0:
            self._newest = ROWS - TAPS
            self._inputs[self._newest + 1 :] = self._inputs[: TAPS - 1]
        else:
            self._newest -= 1
        inputs = self._inputs[self._newest : self._newest + TAPS]
        now = inputs[0]
        now[:3] = self._inverse @ wheel_speed
        now[3:] = load_torque.take(self._legs)
        if not math.isfinite(now.sum()):
            now[:] = inputs[1]
        if self._count == 0:
            inputs[:, 3:] = now[3:]
        self._count += 1
        fastest = max(abs(sent) for sent in now[:3].tolist())
        self._standing_ticks = self._standing_ticks + 1 if fastest < STANDING else 0
        return inputs


def fit_base(robot: RobotConfig, recordings: Sequence[Recording], *, window: int) -> BaseModel:
    """Identify the response on every other recording, and bounds that hold on all of them.

    Args:
        robot: Its description.
        recordings: Two or more of free whole-body motion, the base moving.
        window: Samples of the median.
    """
    fitted = [_regression(robot, recording) for recording in recordings[::2]]
    rows, targets = zip(*fitted, strict=True)
    x, y = np.concatenate(rows), np.concatenate(targets)
    gram = x.T @ x
    gram += RIDGE * np.mean(np.diag(gram)) * np.eye(len(gram))
    coefficients = np.linalg.solve(gram, x.T @ y)
    largest = {True: np.full(3, 1e-6), False: np.full(3, 1e-6)}
    for recording in recordings:
        known, twist = _regression(robot, recording)
        error = known @ coefficients - twist
        median = np.median(np.lib.stride_tricks.sliding_window_view(error, window, axis=0), axis=-1)
        sent = np.abs(known.reshape(len(known), TAPS, -1)[:, :, :3]).max(axis=(1, 2))
        stands = sent[window - 1 :] < STANDING
        for case in (True, False):
            seen = np.abs(median[stands == case])
            if len(seen):
                largest[case] = np.maximum(largest[case], seen.max(axis=0))
    driving = np.maximum(largest[False], largest[True])
    return BaseModel(
        coefficients=tuple((float(a), float(b), float(c)) for a, b, c in coefficients),
        standing=_triple(MARGIN * largest[True]),
        driving=_triple(MARGIN * driving),
    )


def _regression(robot: RobotConfig, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """(n, inputs) known of each tick with TAPS - 1 before it; (n, 3) measured twist."""
    inverse = np.asarray(robot.wheels.inverse)
    sent = recording.sent_wheel_speed @ inverse.T
    load = recording.load_torque[:, _legs(robot)]
    inputs = np.hstack((sent, load))
    windows = np.lib.stride_tricks.sliding_window_view(inputs, TAPS, axis=0)[:, :, ::-1]
    known = windows.transpose(0, 2, 1).copy()
    known[:, :, 3:] -= known[:, -1:, 3:]
    twist = recording.wheel_speed[TAPS - 1 :] @ inverse.T
    return known.reshape(len(known), -1), twist


def _legs(robot: RobotConfig) -> list[int]:
    return [robot.joint_index(name) for name in robot.chains["legs"]]


def _triple(values: FloatArray) -> Triple:
    a, b, c = map(float, values)
    return a, b, c
