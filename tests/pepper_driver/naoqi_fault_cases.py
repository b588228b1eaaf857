"""A robot that moves arms and wheels over real qi when something goes wrong, and what it really did then."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import pepper_driver.backends.naoqi.backend as naoqi_backend
from pepper_driver import Pepper
from pepper_driver.backends.naoqi_server.black_box import BlackBox, row_type
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import (
    PepperError,
    load_doctor_settings,
    load_naoqi_settings,
    load_robot,
)

ROBOT = load_robot()
FORWARD = 0.15  # [m/s]
TRIES = 6  # on a machine so busy that the robot is stopped before anything is wrong
DEAD_MAN = 0.15  # [s]
STANDS = load_doctor_settings().wheel_rest  # [rad/s]


EMPTY = BlackBox.of(np.zeros(0, row_type(ROBOT)))


@dataclass
class Outcome:
    """What came of it. Times are of ``time.monotonic()``.

    Attributes:
        begun: When the fault was set.
        ended: When the client's run ended.
        closed: When it had left the robot.
        error: With which its run ended; None where it did not.
        ages: (time, age of the sample [s]) of its ticks after the fault.
        box: What the robot did, from half a second before the fault to half a second after the client's run.
        withheld: Commands that were not sent.
    """

    begun: float
    ended: float = 0.0
    closed: float = 0.0
    error: PepperError | None = None
    ages: list[tuple[float, float]] = field(default_factory=list)
    box: BlackBox = field(default_factory=lambda: EMPTY)
    withheld: int = 0


def url(stand_in: StandIn) -> str:
    return f"naoqi://127.0.0.1:{stand_in.port}"


def since(stand_in: StandIn, moment: float) -> BlackBox:
    """The cycles that were due after a moment."""
    box = stand_in.black_box()
    return BlackBox(**{name: rows[box.begin > moment] for name, rows in vars(box).items()})


@contextmanager
def quick_settings() -> Iterator[None]:
    """Ramps and measurements at the start that take no longer than tests need."""
    settings = load_naoqi_settings()
    timing = replace(settings.timing, burst=0.2, ramp_up=0.5, ramp_down=0.1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            naoqi_backend, "load_naoqi_settings", lambda: replace(settings, timing=timing)
        )
        yield


def drive(stand_in: StandIn, fault: str, seconds: float, *, watch: float = 0.3) -> Outcome:
    """Move arms and wheels, set a fault, run on for some time or until the run ends; watch the robot, then leave it."""
    why: list[str] = []
    for _ in range(TRIES):
        stand_in.clear_faults()
        outcome: Outcome | None = None
        try:
            with Pepper(url(stand_in), observer=None) as pepper:
                begin_to_move(pepper)
                if not moves(stand_in):
                    box = stand_in.black_box(1)
                    told, stiff = box.wheel_command[0].round(2), box.wheel_stiffness[0]
                    why.append(f"its wheels do not turn, told {told} with stiffness {stiff}")
                    continue
                outcome = Outcome(begun=time.monotonic())
                stand_in.set_fault(fault)
                ages = outcome.ages

                def on_tick(tick: object, _: object) -> None:
                    measurement = tick.measurement  # type: ignore[attr-defined]
                    ages.append((time.monotonic(), measurement.age))
                    outcome.withheld = measurement.withheld  # type: ignore[union-attr]

                try:
                    pepper.run(seconds, on_tick=on_tick)
                except PepperError as error:
                    outcome.error = error
                outcome.ended = time.monotonic()
                time.sleep(watch)
                outcome.box = since(stand_in, outcome.begun - 0.5)
                left = time.monotonic()
        except PepperError as error:
            if outcome is None:
                why.append(str(error))
                continue  # stopped before anything was wrong
            if not len(outcome.box):
                raise
        assert outcome is not None
        outcome.closed = time.monotonic() - left
        return outcome
    raise AssertionError(f"no robot that moves, perhaps because this machine is too busy: {why}")


def begin_to_move(pepper: Pepper) -> None:
    """Arms up, slowly, and forward."""
    goal = pepper.controller.position.copy()
    for joint in ("LShoulderPitch", "RShoulderPitch"):
        goal[ROBOT.joint_names.index(joint)] = 0.3
    pepper.set_posture(goal, duration=6.0)
    pepper.controller.base_velocity.target = [FORWARD, 0.0, 0.0]
    pepper.run(0.6)


def moves(stand_in: StandIn) -> bool:
    box = stand_in.black_box(3)
    return bool((np.abs(box.wheel_speed).max(axis=1) > 1.0).all())


def assert_wheels_stop(box: BlackBox) -> None:
    """With nobody's help: 150 ms after the last order for wheels that was taken, all wheels of the plant stand."""
    after = box.begin - box.wheel_order[-1] >= DEAD_MAN
    speed = np.abs(box.wheel_speed[after]).max(axis=1)
    assert len(speed) > 10
    assert speed[0] <= STANDS, speed.round(3).tolist()
    assert speed.max() <= 2 * STANDS, speed.round(3).tolist()  # the robot rocks back
    assert not box.wheel_command[after].any()


def assert_joints_hold(box: BlackBox, since: float) -> None:
    """From a tenth of a second after a moment on they stay where they were told to be; the stiffness too."""
    held = box.begin > since + 0.1
    assert np.ptp(box.position_command[held], axis=0).max() == 0.0
    assert np.ptp(box.position[held], axis=0).max() < 0.05  # moving joints run out
    assert np.ptp(box.stiffness[held], axis=0).max() == 0.0


def largest_step(box: BlackBox) -> float:
    """Of what joints were told, from a cycle to the next [rad]; cycles that were left out count as one each."""
    steps = np.abs(np.diff(box.position_command, axis=0)).max(axis=1) / np.diff(box.cycle)
    return float(steps.max())
