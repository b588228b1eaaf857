"""A robot that moves arms and wheels over real qi when something goes wrong, and what it really did then."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from pepper_driver import Pepper
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, row_type
from pepper_driver.config import (
    PepperError,
    load_doctor_settings,
    load_robot,
)
from pepper_driver.controller import Tick
from support.stand_ins import PATIENT, patient_driver, since
from support.waiting import PATIENCE, wait_until

ROBOT = load_robot()
FORWARD = 0.15  # [m/s]
TRIES = 6  # on a machine so busy that the robot is stopped before anything is wrong
DEAD_MAN = 0.15  # [s]
STANDS = load_doctor_settings().wheel_rest  # [rad/s]


EMPTY = BlackBox.of(np.zeros(0, row_type(ROBOT)))


@dataclass
class QpStatus:
    """What came of it. Times are of ``time.monotonic()``.

    Attributes:
        begun: When the fault was about to be set.
        wrong: When it was set.
        ended: When the client's run ended.
        closed: When it had left the robot.
        error: With which its run ended; None where it did not.
        ages: (time, age of the sample [s]) of its ticks after the fault.
        box: What the robot did, from half a second before the fault to half a second after the client's run.
        dropped_commands: Commands that were not sent.
    """

    begun: float
    wrong: float = 0.0
    ended: float = 0.0
    closed: float = 0.0
    error: PepperError | None = None
    ages: list[tuple[float, float]] = field(default_factory=list)
    box: BlackBox = field(default_factory=lambda: EMPTY)
    dropped_commands: int = 0


def url(stand_in: StandIn) -> str:
    return f"naoqi://127.0.0.1:{stand_in.port}"


@contextmanager
def quick_settings() -> Iterator[None]:
    """Ramps and measurements at the start that take no longer than tests need."""
    with patient_driver(burst=0.2, ramp_up=0.5, ramp_down=0.1):
        yield


def drive(stand_in: StandIn, fault: str, seconds: float, *, watch: float = 0.3) -> QpStatus:
    """Move arms and wheels, set a fault, run on for some time or until the run ends; watch the robot, then leave it."""
    return drive_through(stand_in, [fault], seconds, watch=watch)[0]


def drive_through(
    stand_in: StandIn, faults: Sequence[str], seconds: float, *, watch: float = 0.0
) -> list[QpStatus]:
    """The same with one fault after the other, each cleared before the next, in one run of the robot."""
    why: list[str] = []
    for _ in range(TRIES):
        stand_in.clear_faults()
        outcomes: list[QpStatus] = []
        try:
            with Pepper(url(stand_in), observer=None, safety=PATIENT) as pepper:
                begin_to_move(pepper)
                end = time.monotonic() + PATIENCE
                while what_is_still(stand_in) and time.monotonic() < end:
                    pepper.run(0.1)
                if problem := what_is_still(stand_in):
                    why.append(problem)
                    continue
                for fault in faults:
                    move_arms(pepper)
                    outcome = QpStatus(begun=time.monotonic())
                    stand_in.set_fault(fault)
                    outcome.wrong = time.monotonic()
                    outcome.error = run(pepper, seconds, outcome)
                    outcome.ended = time.monotonic()
                    wait_for_cycles(stand_in, round(watch / ROBOT.cycle))
                    outcome.box = since(stand_in, outcome.begun - 0.5)
                    outcomes.append(outcome)
                    if fault != faults[-1]:
                        stand_in.clear_faults()
                left = time.monotonic()
        except PepperError as error:
            if len(outcomes) < len(faults):  # stopped before all was wrong that is to be
                why.append(str(error))
                continue
        outcome.closed = time.monotonic() - left
        return outcomes
    raise AssertionError(f"no robot that moves, perhaps because this machine is too busy: {why}")


def wait_for_cycles(stand_in: StandIn, number: int) -> None:
    """Until the robot has made so many more."""
    now = time.monotonic()
    assert wait_until(lambda: len(since(stand_in, now)) >= number)


def run(pepper: Pepper, seconds: float, outcome: QpStatus) -> PepperError | None:
    """What ended the run, if anything did."""

    def on_tick(tick: Tick, _: object) -> None:
        outcome.ages.append((time.monotonic(), tick.measurement.age))
        outcome.dropped_commands = tick.measurement.dropped_commands

    try:
        pepper.run(seconds, on_tick=on_tick)
    except PepperError as error:
        return error
    return None


def begin_to_move(pepper: Pepper) -> None:
    """Arms and wheels."""
    move_arms(pepper)
    pepper.controller.base_velocity.target = [FORWARD, 0.0, 0.0]
    pepper.run(0.6)


def move_arms(pepper: Pepper) -> None:
    """Up where they are down, for four seconds; or down."""
    goal = pepper.controller.position.copy()
    for joint in ("LShoulderPitch", "RShoulderPitch"):
        place = ROBOT.joint_names.index(joint)
        goal[place] = 0.0 if goal[place] > 0.9 else 1.8
    pepper.set_posture(goal, duration=4.0)


def what_is_still(stand_in: StandIn) -> str:
    """Says why the wheels do not turn; nothing where they do."""
    box = stand_in.black_box(3)
    if (np.abs(box.wheel_speed).max(axis=1) > 1.0).all():
        return ""
    told, stiffness = box.wheel_command[-1].round(2), box.wheel_stiffness[-1]
    return f"its wheels do not turn, told {told} with stiffness {stiffness}"


def joints_rest(stand_in: StandIn) -> bool:
    """Return True if no joint has moved for 1.2 s: after a run ALMotion leads joints back by itself."""
    box = stand_in.black_box(100)
    return len(box.position) == 100 and float(np.ptp(box.position, axis=0).max()) < 0.002


def assert_wheels_stop(box: BlackBox) -> None:
    """With nobody's help: 150 ms after the last order for wheels that was taken, all wheels of the plant stand."""
    # Cycles may have been left out since.
    ordered = int(np.searchsorted(box.begin, box.wheel_order[-1]))
    after = slice(ordered + math.ceil(DEAD_MAN / ROBOT.cycle), None)
    speed = np.abs(box.wheel_speed[after]).max(axis=1)
    assert len(speed) > 10
    assert speed[0] <= STANDS, speed.round(3).tolist()
    assert speed.max() <= 2 * STANDS, speed.round(3).tolist()  # the robot rocks back
    assert not box.wheel_command[after].any()


def assert_joints_hold(
    box: BlackBox, since: float, *, but: Sequence[str] = (), late: float = 0.0
) -> None:
    """From a tenth of a second after a moment on they stay where they were told to be; the stiffness too.

    Commands that come ``late`` may change that by so much [rad].
    """
    held = box.begin > since + 0.1
    chosen = [place for place, name in enumerate(ROBOT.joint_names) if name not in but]
    assert np.ptp(box.position_command[held][:, chosen], axis=0).max() <= late
    assert np.ptp(box.position[held][:, chosen], axis=0).max() < 0.05  # moving joints run out
    assert np.ptp(box.stiffness[held][:, chosen], axis=0).max() == 0.0


def largest_step(box: BlackBox) -> float:
    """Of what joints were told, from a cycle to the next [rad]; cycles that were left out count as one each."""
    steps = np.abs(np.diff(box.position_command, axis=0)).max(axis=1) / np.diff(box.cycle)
    return float(steps.max())
