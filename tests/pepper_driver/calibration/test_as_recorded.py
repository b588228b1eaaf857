"""The commands as recorded: results against made-up runs with known answers, and plants that differ in them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.calibration.as_recorded import (
    ChaseReport,
    FalseContacts,
    as_recording,
    chase_figures,
    explained,
    false_contacts,
    gravity_at_goals,
    play_chases,
    slope,
    trapezoid,
)
from pepper_driver.calibration.calibrate import AS_COUNTED, check_chases
from pepper_driver.calibration.testbench import GoalRun, gravity_torque
from pepper_driver.config import (
    RobotIdentity,
    load_calibration,
    load_plant,
    load_robot,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer import load_shipped

ROBOT = load_robot()
NOMINAL = replace(load_plant("nominal", ROBOT), base="fixed")
REAL = load_calibration(ROBOT)
PROTOCOL = REAL.settings.chases
JOINT = "RElbowRoll"
INDEX = ROBOT.joint_index(JOINT)
CYCLE, STEP = ROBOT.cycle, ROBOT.sensors.encoder.step
CONSTANT = ROBOT.motors.joint_torque_constant(JOINT)


def test_a_trapezoid_goes_at_constant_speed_between_its_ramps() -> None:
    way = trapezoid(100, 0.2)
    assert way[-1] == pytest.approx(1.0)
    speed = np.diff(way, prepend=0.0) * 100
    np.testing.assert_allclose(speed[20:80], 1 / 0.8)
    assert (np.diff(speed[:20]) > 0).all()
    assert (np.diff(speed[80:]) < 0).all()
    np.testing.assert_allclose(way + way[::-1] - speed[::-1] / 100, 1.0, atol=1e-12)


def test_the_protocol_is_as_fast_as_the_recordings() -> None:
    """RShoulderPitch is commanded 4.5 rad/s at the 90th percentile and about 12 rad/s at most."""
    rng = np.random.default_rng(0)
    index = ROBOT.joint_index("RShoulderPitch")
    span = ROBOT.upper[index] - ROBOT.lower[index]
    goals = rng.uniform(-0.5, 0.5, 162) * span * PROTOCOL.range
    speeds = np.concatenate(
        [
            np.abs(np.diff(trapezoid(round(t / CYCLE), PROTOCOL.ease), prepend=0.0) * way / CYCLE)
            for t, way in zip(rng.uniform(*PROTOCOL.move, 161), np.diff(goals), strict=True)
        ]
    )
    assert np.percentile(speeds, 90) == pytest.approx(4.5, rel=0.15)
    assert 9.0 < speeds.max() < 14.0


def test_slope_and_explained_variance_of_known_lines() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.standard_normal((2, 20_000))
    assert slope(x, 3.0 * x + 1.0) == pytest.approx(3.0)
    assert explained(x, -2.0 * x) == pytest.approx(1.0)
    assert explained(x, x + noise) == pytest.approx(0.5, abs=0.02)
    assert explained(np.ones(5), np.arange(5.0)) == 0.0


def made_up(
    count: int = 60,
    *,
    delay: int = 6,
    side: float = 0.0,
    droop: float = 0.0,
    ratio: float = 1.0,
    creep: float = 0.0,
    drift: float = 0.0,
    jump: float = 0.0,
) -> GoalRun:
    """A run of one joint that answers exactly: late by ``delay`` ticks, resting off by ``side`` [rad] and by gravity.

    ``droop`` [rad/(N m)], ``ratio`` of current to gravity, ``creep`` [A/s], ``drift`` [rad] without current in every
    fifth hold, ``jump`` of the current in every move [A].
    """
    rng = np.random.default_rng(1)
    stand = ROBOT.posture("Stand")
    move, wait = 40, 167
    goals = rng.uniform(0.1, 1.5, count)
    rows: list[float] = []
    off: list[float] = []
    currents: list[float] = []
    begins: list[int] = []
    ends: list[int] = []
    here = stand[INDEX]
    for number, goal in enumerate(goals):
        posture = stand.copy()
        posture[INDEX] = goal
        load = gravity_torque(ROBOT, NOMINAL, posture[None])[0, INDEX]
        error = side * np.sign(goal - here) + droop * load
        current = abs(ratio * load / CONSTANT)
        if drift and number % 5 == 0:
            error, current = drift, 0.0
        begins.append(len(rows))
        rows += [here + (goal - here) * k / move for k in range(1, move + 1)] + [goal] * wait
        ends.append(len(rows))
        off += [error] * (move + wait)
        currents += [current + jump] * move + [current + creep * CYCLE * k for k in range(wait)]
        here = goal
    command = np.tile(stand, (len(rows), 1))
    command[:, INDEX] = rows
    position = command.copy()
    position[:, INDEX] = np.concatenate(
        (np.full(delay, stand[INDEX]), (np.array(rows) - off)[:-delay])
    )
    current = np.zeros_like(command)
    current[:, INDEX] = np.concatenate((np.zeros(delay), currents[:-delay]))
    return GoalRun(
        command=command,
        position=position,
        current=current,
        age=np.zeros(len(rows)),
        begins=tuple(begins),
        ends=tuple(ends),
    )


def figures_of(**changes: Any) -> Any:
    runs = [made_up(**changes)]
    return chase_figures(ROBOT, JOINT, runs, gravity_at_goals(ROBOT, NOMINAL, runs), 100.0)


def test_the_side_of_approach_is_found() -> None:
    found = figures_of(side=0.01)
    assert found.median_deg == pytest.approx(np.degrees(0.01))
    assert (found.short, found.beyond) == (1.0, 0.0)
    assert found.r2_side == pytest.approx(1.0)
    beyond = figures_of(side=-0.01)
    assert (beyond.short, beyond.beyond) == (0.0, 1.0)


def test_droop_and_gravity_current_are_found() -> None:
    found = figures_of(droop=0.02, ratio=1.9)
    assert found.droop_deg == pytest.approx(np.degrees(0.02), rel=1e-3)
    assert found.r2_gravity == pytest.approx(1.0)
    assert found.gravity_torque == pytest.approx(1.9, rel=1e-3)
    assert found.r2_current == pytest.approx(1.0, abs=1e-6)
    # From below means to a higher goal: the side depends on gravity too.
    assert found.r2_side < 0.6


def test_the_onsets_are_found() -> None:
    """The made-up joint answers a command of a degree a tick and more after the delay, the current with a jump."""
    for delay in (3, 6):
        found = figures_of(delay=delay, jump=0.2)
        assert found.encoder_onset_ms == pytest.approx(1e3 * CYCLE * delay)
        assert found.current_onset_ms == pytest.approx(1e3 * CYCLE * delay)


def test_errors_without_current_are_counted() -> None:
    assert figures_of(droop=0.01).without_current == 0.0
    assert figures_of(droop=0.01, drift=0.03).without_current == pytest.approx(0.2)


def test_creeping_currents_are_counted() -> None:
    assert figures_of(droop=0.01).creep == 0.0
    assert figures_of(droop=0.01, creep=0.1).creep == 1.0


def report(**changes: Any) -> ChaseReport:
    chases = REAL.recordings.chases
    figures = {
        joint: replace(found, **changes) if joint == JOINT else found
        for joint, found in chases.figures.items()
    }
    return ChaseReport(
        figures=figures,
        false_contacts=FalseContacts(count=2, minutes=60.0, by_joint={"RWristYaw": 2}, blind=0.1),
        identified_on="a robot",
        real=chases,
        settings=REAL.settings,
    )


def test_the_real_robot_holds_in_all_cells() -> None:
    cells = report().cells
    assert len(cells) == 20
    assert all(cell.passed for cell in cells)


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({"median_deg": 0.51 * 1.51}, ["hold median"]),
        ({"median_deg": 0.51 * 1.49}, []),
        ({"p90_deg": 0.82 / 1.51}, ["hold p90"]),
        ({"gravity_torque": 1.2}, ["gravity current"]),
        ({"current_onset_ms": 36.0}, ["latency"]),
        ({"encoder_onset_ms": None}, ["latency"]),
        ({"r2_side": 0.18}, ["R2 by side"]),
        ({"r2_side": 0.16}, []),
        ({"max_deg": 99.0, "droop_deg": 9.0}, []),
    ],
)
def test_a_cell_is_missed_beyond_its_limit(changes: dict[str, Any], missed: list[str]) -> None:
    assert [c.quantity for c in report(**changes).cells if not c.passed] == missed


def test_an_observer_is_given_commands_with_the_samples_that_answer_them() -> None:
    run = made_up(count=2, delay=6)
    model = RobotModel(ROBOT)
    recording = as_recording(ROBOT, run, model, 6)
    error: FloatArray = recording.tracking_error(INDEX)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)
    np.testing.assert_allclose(
        np.cumsum(recording.velocity[:, INDEX]) * CYCLE,
        recording.sent_position[:, INDEX] - recording.sent_position[0, INDEX],
        atol=1e-9,
    )
    still = ~recording.velocity.any(axis=1) & ~recording.acceleration.any(axis=1)
    loads = gravity_torque(ROBOT, NOMINAL, recording.sent_position[still][:3])
    np.testing.assert_allclose(recording.load_torque[still][:3], loads, atol=1e-6)


def small_bench(name: str, count: int = 20) -> tuple[Any, Any]:
    plant = load_plant(name, ROBOT)
    return plant, play_chases(ROBOT, plant, replace(PROTOCOL, count=count), 5, workers=1)


def test_the_side_explains_less_on_the_recorded_plant_and_gravity_takes_more() -> None:
    """Twenty goals distinguish it from nominal; how near it comes is measured by `pepper calibrate --check`."""
    found: dict[str, list[Any]] = {}
    for name in ("nominal", "recorded"):
        plant, runs = small_bench(name)
        found[name] = [
            chase_figures(ROBOT, joint, runs, gravity_at_goals(ROBOT, plant, runs), 100.0)
            for joint in ("RElbowYaw", "RElbowRoll")
        ]
    assert found["recorded"][0].gravity_torque > 1.8 * found["nominal"][0].gravity_torque
    nominal, recorded = found["nominal"][1], found["recorded"][1]
    assert recorded.gravity_torque > nominal.gravity_torque
    assert recorded.encoder_onset_ms >= nominal.encoder_onset_ms + 24.0
    assert recorded.current_onset_ms >= nominal.current_onset_ms + 24.0
    assert recorded.encoder_noise_mdeg < 0.7 * nominal.encoder_noise_mdeg
    assert recorded.short < 0.75
    assert recorded.beyond > 0.2
    assert recorded.creep > nominal.creep
    assert recorded.max_speed < 4.5


def test_models_of_another_robot_raise_contacts_and_its_own_hardly_any() -> None:
    nominal = load_plant("nominal", ROBOT)
    identity = RobotIdentity(name="nominal", identity=plant_hash(nominal, ROBOT))
    models = load_shipped("fusion", [identity])
    rates = {}
    for name in ("nominal", "plateau"):
        plant, runs = small_bench(name)
        counted = false_contacts(
            ROBOT, runs, models, plant.response_delay, parts=AS_COUNTED, workers=1
        )
        assert sum(counted.by_joint.values()) == counted.count
        rates[name] = counted.per_hour
    assert rates["nominal"] < 100.0
    assert rates["plateau"] > 500.0
    # With the law of the boards, joints that fall behind are blind instead.
    whole = false_contacts(ROBOT, runs, models, plant.response_delay, workers=1)
    assert whole.per_hour < 100.0
    assert whole.blind > counted.blind + 0.05


@pytest.mark.whole
@pytest.mark.parametrize("name", ["recorded", "recorded-heavy"])
def test_the_recorded_plants_are_as_recorded(name: str) -> None:
    """18 of 20 cells; `integral` alone has 15."""
    found = check_chases(ROBOT, load_plant(name, ROBOT), REAL)
    assert sum(cell.passed for cell in found.cells) >= 18
