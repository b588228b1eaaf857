"""A robot that moves arms and wheels over NAOqi when something goes wrong, and what it really did then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pepper_driver import Pepper
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, row_type
from pepper_driver.config import (
    PepperError,
    load_doctor_settings,
    load_robot,
)
from pepper_driver.controller import Tick
from support.virtual_naoqi import VirtualNaoqi

ROBOT = load_robot()
FORWARD = 0.15  # [m/s]
DEAD_MAN = 0.15  # [s]
STANDS = load_doctor_settings().wheel_rest  # [rad/s]


EMPTY = BlackBox.of(np.zeros(0, row_type(ROBOT)))


@dataclass
class Outcome:
    """Result of a run with a fault. Times are of virtual time [s].

    Attributes:
        begun: When the fault was set.
        ended: When the client's run ended.
        closed: How long it took to leave the robot [s].
        error: With which its run ended; None where it did not.
        ages: (time, age of the sample [s]) of its ticks after the fault.
        box: What the robot did, from half a second before the fault on.
    """

    begun: float
    ended: float = 0.0
    closed: float = 0.0
    error: PepperError | None = None
    ages: list[tuple[float, float]] = field(default_factory=list)
    box: BlackBox = field(default_factory=lambda: EMPTY)


def drive(robot: VirtualNaoqi, fault: str, seconds: float, *, watch: float = 0.3) -> Outcome:
    """Move arms and wheels, set a fault, run on for some time or until the run ends; watch the robot, then leave it."""
    return drive_through(robot, [fault], seconds, watch=watch)[0]


def drive_through(
    robot: VirtualNaoqi, faults: Sequence[str], seconds: float, *, watch: float = 0.0
) -> list[Outcome]:
    """The same with one fault after the other, each cleared before the next, in one run of the robot."""
    outcomes: list[Outcome] = []
    with robot.pepper() as pepper:
        begin_to_move(pepper)
        assert_drives(robot.black_box(3))
        for fault in faults:
            move_arms(pepper)
            outcome = Outcome(begun=robot.time.seconds())
            robot.set_fault(fault)
            outcome.error = run(robot, pepper, seconds, outcome)
            outcome.ended = robot.time.seconds()
            robot.time.sleep(watch)
            outcome.box = robot.since(outcome.begun - 0.5)
            outcomes.append(outcome)
            if fault != faults[-1]:
                robot.clear_faults()
        left = robot.time.seconds()
    outcome.closed = robot.time.seconds() - left
    return outcomes


def run(
    robot: VirtualNaoqi, pepper: Pepper, seconds: float, outcome: Outcome
) -> PepperError | None:
    """Return the error that ended the run, if any did."""

    def on_tick(tick: Tick, _: object) -> None:
        outcome.ages.append((robot.time.seconds(), tick.measurement.age))

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


def drives(box: BlackBox) -> bool:
    """Return True if the wheels turn in all cycles."""
    return bool((np.abs(box.wheel_speed).max(axis=1) > 1.0).all())


def assert_drives(box: BlackBox) -> None:
    """The wheels turn."""
    assert drives(box), f"commanded {box.wheel_command[-1]}, stiffness {box.wheel_stiffness[-1]}"


def assert_wheels_stop(box: BlackBox) -> None:
    """Without help: 150 ms after the last order for wheels that was taken, all wheels of the plant stand."""
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
    """From a tenth of a second after a moment on they stay where they were commanded; the stiffness too.

    Commands that come ``late`` may change that by so much [rad].
    """
    held = box.begin > since + 0.1
    chosen = [place for place, name in enumerate(ROBOT.joint_names) if name not in but]
    assert np.ptp(box.position_command[held][:, chosen], axis=0).max() <= late
    assert np.ptp(box.position[held][:, chosen], axis=0).max() < 0.05  # moving joints run out
    assert np.ptp(box.stiffness[held][:, chosen], axis=0).max() == 0.0


def max_step(box: BlackBox) -> float:
    """Largest step of the joints' commands from a cycle to the next [rad]; cycles left out count as one each."""
    steps = np.abs(np.diff(box.position_command, axis=0)).max(axis=1) / np.diff(box.cycle)
    return float(steps.max())
