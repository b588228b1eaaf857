"""Motors that do not follow their command: soft by another program, or without an answer."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends import Command, Measurement
from pepper_driver.config.arrays import FloatArray
from pepper_driver.safety import FaultReason, RobotState, SafetyGate
from pepper_driver.testing import displaced, standing_measurement
from support.fakes import reference
from support.safety import ONES, ROBOT, SAFETY, STAND, STILL, active_gate

HEAD, ELBOW, HAND = (ROBOT.joint_index(name) for name in ("HeadYaw", "RElbowYaw", "RHand"))
TAKEN_TICKS = round(SAFETY.stiffness_time / ROBOT.cycle)
SILENT_TICKS = round(SAFETY.frozen_time / ROBOT.cycle)


def reporting(stiffness: FloatArray | None) -> Measurement:
    return replace(standing_measurement(), stiffness=stiffness)


def less(by: float, *joints: int) -> FloatArray:
    stiffness = np.ones(17)
    stiffness[list(joints) or slice(None)] -= by
    return stiffness


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ((), "all joints was lowered from outside (0.00 in place of 1.00)"),
        ((ELBOW,), "stiffness of RElbowYaw was lowered"),
        ((3, 4, 5, 6, 7), "HeadYaw, HeadPitch, LShoulderPitch and 2 more"),
    ],
)
def test_stiffness_that_is_lowered_from_outside_stops_the_robot(
    joints: tuple[int, ...], words: str
) -> None:
    g = active_gate()
    for _ in range(TAKEN_TICKS):
        g.watch(reporting(less(1.0, *joints)), g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(reporting(less(1.0, *joints)), g.sent)
    assert g.fault is not None
    assert g.fault.reason is FaultReason.STIFFNESS
    assert words in g.fault.text
    for what in ("from outside", "chest", "ALMotion.rest", "setStiffnesses", "wake the robot up"):
        assert what in g.fault.text, "what may have happened, and what to do"
    assert "\n" not in g.fault.text


@pytest.mark.parametrize(
    "stiffness",
    [None, np.full(17, np.nan), less(SAFETY.stiffness_loss), ONES, np.full(17, 1.5)],
)
def test_stiffness_that_is_there_or_not_known_stops_nothing(stiffness: FloatArray | None) -> None:
    g = active_gate()
    for _ in range(100):
        g.watch(reporting(stiffness), g.sent)
    assert g.state is RobotState.ACTIVE


def test_a_moment_without_stiffness_stops_nothing() -> None:
    g = active_gate()
    for tick in range(200):
        g.watch(reporting(less(float(tick % (TAKEN_TICKS + 1) != 0))), g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(reporting(ONES), g.sent)
    for _ in range(TAKEN_TICKS + 1):
        assert g.fault is None
        g.watch(reporting(less(1.0)), g.sent)
    assert g.fault is not None


@pytest.mark.parametrize("delay", [0, 8, 20, 50])
def test_the_gates_own_ramp_is_no_theft(delay: int) -> None:
    """Boards have any command from the one answered, ``delay`` ticks ago, to the newest."""
    for shown in {0, delay // 2, delay}:
        g = active_gate()
        sent: list[Command] = [g.sent] * (delay + 1)
        for tick in range(400):
            requested = ONES if (tick // 100) % 2 else np.full(17, 0.0)
            g.watch(reporting(sent[-1 - shown].stiffness), sent[-1 - delay])
            sent.append(g.gate(reference(STAND), requested, STILL, 0.0).command)
        assert g.state is RobotState.ACTIVE
        assert min(command.stiffness.min() for command in sent) < 0.01


def test_softened_joints_may_still_be_taken() -> None:
    g = active_gate()
    for _ in range(100):
        g.gate(reference(STAND), np.full(17, 0.5), STILL, 0.0)
    for _ in range(TAKEN_TICKS + 1):
        g.watch(reporting(np.zeros(17)), g.sent)
    assert g.fault is not None
    assert "0.00 in place of 0.50" in g.fault.text


# -- a joint that does not answer -----------------------------------------------------------------------------------


def watched(
    change: Callable[[int, Measurement], Measurement],
    *,
    joint: int = ELBOW,
    ticks: int = 40,
    stiffness: float = 1.0,
    motion: float = 2.0 * SAFETY.frozen_motion,
) -> SafetyGate:
    """A gate that has seen ``joint`` stand far from its command, with currents that tremble, but where changed.

    After the second tick the command is farther away by ``motion`` [rad].
    """
    g = active_gate()
    answered = replace(g.sent, stiffness=np.full(17, stiffness))
    moved = answered.position.copy()
    moved[joint] -= motion
    random = np.random.default_rng(1)
    far = displaced(ROBOT.joint_names[joint], SAFETY.frozen_distance + 0.05)
    for tick in range(ticks):
        current = np.float64(0.016) * random.integers(10, 14, 17)
        measurement = far(replace(standing_measurement(), current=current))
        g.watch(
            change(tick, measurement), answered if tick < 2 else replace(answered, position=moved)
        )
    return g


def standing(joint: int) -> Callable[[int, Measurement], Measurement]:
    """The joint's current does not change either."""

    def change(tick: int, measurement: Measurement) -> Measurement:
        current = measurement.current.copy()
        current[joint] = 0.1
        return replace(measurement, current=current)

    return change


def test_a_joint_that_does_not_answer_stops_the_robot() -> None:
    g = watched(standing(ELBOW), ticks=SILENT_TICKS + 2)
    assert g.state is RobotState.ACTIVE
    g = watched(standing(ELBOW), ticks=SILENT_TICKS + 3)
    assert g.fault is not None
    assert g.fault.reason is FaultReason.FROZEN_JOINT
    assert "RElbowYaw does not answer" in g.fault.text
    assert "unplugged" in g.fault.text


@pytest.mark.parametrize("motion", [0.0, 0.9 * SAFETY.frozen_motion])
def test_a_joint_that_a_load_keeps_off_its_command_may_stand_as_long_as_that_rests(
    motion: float,
) -> None:
    """A wrist with a load may rest ten degrees off, with a current that trembles by less than a count."""
    assert watched(standing(ELBOW), ticks=600, motion=motion).state is RobotState.ACTIVE


def test_a_joint_that_a_load_keeps_off_its_command_shows_the_next_command() -> None:
    """A command that moves after a minute is no fault at once: the answer of a late robot is under way."""
    g = active_gate()
    rest = g.sent
    random = np.random.default_rng(1)
    far = displaced("RElbowYaw", SAFETY.frozen_distance + 0.05)
    for tick in range(600):
        command = rest.position.copy()
        command[ELBOW] -= 2.0 * SAFETY.frozen_motion * (tick >= 500)
        current = np.float64(0.016) * random.integers(10, 14, 17)
        current[ELBOW] = 0.1 if tick < 500 + SILENT_TICKS else 0.116
        measurement = far(replace(standing_measurement(), current=current))
        g.watch(measurement, replace(rest, position=command))
    assert g.state is RobotState.ACTIVE


def test_a_joint_that_is_held_firmly_answers() -> None:
    """Its encoder stands, its current trembles; or the other way round."""
    assert watched(lambda _, measurement: measurement).state is RobotState.ACTIVE

    def yields(tick: int, measurement: Measurement) -> Measurement:
        position = measurement.position.copy()
        position[ELBOW] += 0.0015 * (tick % 2)
        return standing(ELBOW)(tick, replace(measurement, position=position))

    assert watched(yields).state is RobotState.ACTIVE


def test_a_count_in_between_is_an_answer() -> None:
    def now_and_then(tick: int, measurement: Measurement) -> Measurement:
        return measurement if tick % (SILENT_TICKS + 2) == 0 else standing(ELBOW)(tick, measurement)

    assert watched(now_and_then, ticks=100).state is RobotState.ACTIVE


def test_a_joint_near_its_command_may_stand_for_ever() -> None:
    def near(tick: int, measurement: Measurement) -> Measurement:
        position = STAND.copy()
        position[ELBOW] += SAFETY.frozen_distance - 0.01
        return standing(ELBOW)(tick, replace(measurement, position=position))

    assert watched(near, ticks=100, motion=0.0).state is RobotState.ACTIVE


def test_the_same_sample_once_more_is_no_silence() -> None:
    """Samples stay away, or come from a robot that refreshes them twice a second: then all currents stand."""

    def slow(tick: int, measurement: Measurement) -> Measurement:
        return replace(measurement, current=np.linspace(0.0, 1.0, 17) + tick // 40)

    assert watched(slow, ticks=600).state is RobotState.ACTIVE


@pytest.mark.parametrize(
    ("stiffness", "state"),
    [
        (0.0, RobotState.ACTIVE),
        (SAFETY.min_driven_stiffness, RobotState.ACTIVE),
        (SAFETY.min_driven_stiffness + 0.01, RobotState.FAULT),
    ],
)
def test_a_joint_that_nothing_drives_may_stand(stiffness: float, state: RobotState) -> None:
    """The sample answers a command of this stiffness."""
    assert watched(standing(ELBOW), stiffness=stiffness).state is state


def test_a_hand_around_a_thing_stands() -> None:
    assert watched(standing(HAND), joint=HAND, ticks=100).state is RobotState.ACTIVE


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("HeadYaw",), "commands HeadYaw: end it"),
        (("HeadYaw", "RHand", "WheelFL"), "commands HeadYaw, RHand, WheelFL: end it"),
        (
            ("HeadYaw", "RHand", "WheelFL", "WheelFR"),
            "commands HeadYaw, RHand, WheelFL and 1 more: end",
        ),
    ],
)
def test_what_another_program_commands_stops_the_robot_and_is_named(
    names: tuple[str, ...], words: str
) -> None:
    g = active_gate()
    g.gate(reference(STAND), ONES, np.full(3, 1.0), 0.0)
    g.watch(replace(reporting(ONES), commanded_by_others=names), g.sent)
    assert g.fault is not None
    assert g.fault.reason is FaultReason.FOREIGN_COMMAND
    assert words in g.fault.text
    for what in ("autonomous life", "Choregraphe", "start again"):
        assert what in g.fault.text
    gated = g.gate(reference(STAND + 0.1), ONES, np.full(3, 2.0), 0.0)
    np.testing.assert_array_equal(gated.command.position, STAND)
    assert not gated.command.wheel_speed.any()


def test_why_samples_stay_away_is_reported() -> None:
    g = active_gate()
    missing = "no answer from RElbowYaw, whose board is off or unplugged"
    g.watch(replace(standing_measurement(), age=0.2, stale_reason=missing), g.sent)
    assert g.fault is not None
    assert g.fault.reason is FaultReason.STALE_SAMPLE
    assert g.fault.text == f"the newest sample is 200 ms old: {missing}"
