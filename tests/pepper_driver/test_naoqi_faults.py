"""What a robot does when something goes wrong with NAOqi, the network or itself, and what its program then says.

Over real qi against the stand-in; what the robot did is in its black box. Facts about the robot are counted in its own
cycles; bounds of the clock on the wall are for busy machines, ``benchmarks/naoqi_faults.py`` measures.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import NotConnectedError
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.safety import FaultError

from naoqi_fault_cases import (  # isort: skip
    STANDS,
    assert_joints_hold,
    assert_wheels_stop,
    drive,
    largest_step,
    quick_settings,
    since,
)

LARGEST_STEP = 0.02  # [rad] of a joint's command, from a cycle to the next


@pytest.fixture(scope="module")
def robot(qi: Any) -> Iterator[StandIn]:
    """Awake, and its owner allows all."""
    with StandIn("mujoco://?seed=3", network="clear", consent=True) as running, quick_settings():
        session = qi.Session()
        session.connect(running.url)
        session.service("ALMotion").wakeUp()
        session.close()
        yield running


# -- nobody hears the robot, or it hears nobody ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        ("cut", NotConnectedError, "connection was lost"),
        ("kill", NotConnectedError, "connection was lost"),
        ("blocked", FaultError, "newest sample is"),
        ("stall:DCM", FaultError, "newest sample is"),
        ("error:DCM", FaultError, "newest sample is"),
        ("none:Position", FaultError, "newest sample is"),
        ("dropped", FaultError, "newest sample is"),
        ("slow:0.3", FaultError, "newest sample is"),
    ],
)
def test_wheels_stop_and_joints_hold(
    robot: StandIn, fault: str, kind: type[Exception], words: str
) -> None:
    outcome = drive(robot, fault, 3.0)
    assert isinstance(outcome.error, kind), outcome.error
    assert words in str(outcome.error)
    assert len(str(outcome.error).splitlines()) == 1
    assert outcome.ended - outcome.begun < 1.0
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)
    assert largest_step(outcome.box) <= LARGEST_STEP
    assert outcome.closed < 5.0  # a service that is asked to get back what it had may not answer


def test_a_robot_that_goes_on_takes_at_most_two_commands(robot: StandIn) -> None:
    """What waited is old: no wheel turns by it, and no joint goes far."""
    outcome = drive(robot, "hang", 3.0)
    assert isinstance(outcome.error, FaultError)
    ages = [age for _, age in outcome.ages]
    assert max(ages[:-1], default=0.0) <= 0.1 < ages[-1]  # the first tick beyond it is the last
    assert outcome.closed < 1.0
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)
    orders, told = outcome.box.orders[-1], outcome.box.position_command[-1]
    goes_on = time.monotonic()
    robot.clear_faults()
    time.sleep(0.3)
    box = since(robot, goes_on)
    assert box.orders[-1] - orders <= 2
    assert np.abs(box.position_command - told).max() <= LARGEST_STEP
    assert not box.wheel_command[-1].any()
    assert np.abs(box.wheel_speed).max() <= STANDS


# -- the robot is not well ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("press:ChestBoard/Button", "chest"),
        ("hot:LElbowRoll,80", "LElbowRoll"),
        ("value:Battery/Charge/Sensor/Value,0.02", "battery"),
    ],
)
def test_the_safety_gate_stops_a_robot_that_is_not_well(
    robot: StandIn, fault: str, words: str
) -> None:
    outcome = drive(robot, fault, 5.0)
    assert isinstance(outcome.error, FaultError)
    assert words in str(outcome.error)
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)


@pytest.mark.parametrize("fault", ["press:FrontLeft", "value:Platform/ILS/Sensor/Value,1"])
def test_a_bumper_or_an_open_flap_stops_the_base_alone(robot: StandIn, fault: str) -> None:
    outcome = drive(robot, fault, 1.0)
    assert outcome.error is None
    assert_wheels_stop(outcome.box)
    moved = np.ptp(outcome.box.position_command[outcome.box.begin > outcome.begun], axis=0)
    assert moved.max() > 0.05


@pytest.mark.parametrize("fault", ["network:wifi", "dropped:0.3", "none:Temperature", "slow:0.005"])
def test_some_things_are_borne(robot: StandIn, fault: str) -> None:
    """The robot goes on, and nothing jumps."""
    outcome = drive(robot, fault, 1.0)
    assert outcome.error is None or "newest sample" in str(outcome.error)  # a busy machine adds to it
    assert largest_step(outcome.box) <= LARGEST_STEP


def test_x(robot: StandIn) -> None:
    for f in ("asleep", "disconnected:LShoulderPitch", "wrong-type"):
        outcome = drive(robot, f, 2.0)
        robot.clear_faults()
        b=outcome.box
        print(f, repr(outcome.error), 'ran %.2f'%(outcome.ended-outcome.begun), 'closed %.2f'%outcome.closed, 'maxage %.3f'%max(a for _,a in outcome.ages), 'step %.4f'%largest_step(b), 'withheld', outcome.withheld, 'wheels end', np.abs(b.wheel_speed[-1]).max().round(2), 'stiff', b.stiffness[-1].min(), 'joint change', np.abs(b.position[-1]-b.position[0]).max().round(3), 'follow', np.abs(b.position-b.position_command)[-1].max().round(3))
