"""Calibration: what is compared and how, values recovered from made-up robots, the command line."""

import json
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pepper_driver.backends.mujoco_.motors import MotorBoards
from pepper_driver.calibration import calibrate, fit
from pepper_driver.calibration.as_recorded import ChaseReport, FalseContacts
from pepper_driver.calibration.calibrate import (
    BenchResult,
    CalibrationMetric,
    CalibrationReport,
    residual,
    statistics,
)
from pepper_driver.calibration.drive import (
    DriveValues,
    drag,
    plant_text,
    score,
    targets,
    values_of,
    with_values,
)
from pepper_driver.calibration.fit import (
    closed_form_fit,
    fit_pd,
    predict_holds,
    ramp_error,
    start_values,
)
from pepper_driver.calibration.plot import calibration_figure
from pepper_driver.calibration.testbench import HoldEnds
from pepper_driver.cli import calibrate as command
from pepper_driver.cli.app import run
from pepper_driver.config import (
    Calibration,
    HoldStatistics,
    PlantConfig,
    RobotConfig,
    TrackingTable,
    load_calibration,
    load_plant,
    load_robot,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.figure_style import joint_title

ROBOT = load_robot()
NOMINAL = load_plant("nominal", ROBOT)
REAL = load_calibration(ROBOT)
TRUE = {
    "RShoulderPitch": DriveValues(stiffness=118.0, friction=1.2),
    "RShoulderRoll": DriveValues(stiffness=95.0, friction=0.7),
    "RElbowYaw": DriveValues(stiffness=61.0, friction=0.35),
    "RElbowRoll": DriveValues(stiffness=78.0, friction=0.5),
    "RWristYaw": DriveValues(stiffness=0.6, friction=0.004, dead_band=float(np.radians(0.4))),
}
"""A made-up robot; the wrist's stiffness is the shipped plant's, which no metric shows."""


def table(errors_deg: list[list[float]]) -> TrackingTable:
    return TrackingTable(
        velocity=(-1.0, 0.0, 1.0),
        torque=(0.0, 2.0),
        expected_error_deg=tuple(tuple(row) for row in errors_deg),
    )


def test_every_moving_cell_counts_alike_and_standing_still_does_not() -> None:
    real = table([[-1.0, 99.0, 1.0], [0.0, 99.0, 2.0]])
    found = np.radians([[-1.0, 1.0], [0.0, 4.0]])
    assert np.degrees(residual(found, real)) == pytest.approx(1.0)  # sqrt(2^2 / 4 cells)
    assert np.degrees(residual(np.radians([[0.0, 1.0], [0.0, 2.0]]), real)) == pytest.approx(0.5)


def test_statistics_are_of_absolute_error_and_of_one_joint() -> None:
    signed = np.linspace(-5.0, 5.0, 101)  # absolute: median 2.5, 90 % at 4.5
    held = HoldEnds(
        joints=("RShoulderRoll", "RElbowRoll"),
        error=np.radians(np.stack([np.full(101, 7.0), signed], axis=1)),
        current=np.stack([np.zeros(101), np.linspace(0.0, 1.0, 101)], axis=1),
        load=np.zeros((101, 2)),
    )
    found = statistics(held, "RElbowRoll")
    assert found.median_deg == pytest.approx(2.5)
    assert found.p90_deg == pytest.approx(4.5)
    assert found.max_deg == pytest.approx(5.0)
    assert found.signed_deg == pytest.approx((-4.5, 0.0, 4.5))
    assert found.current == pytest.approx((0.5, 0.9))


@pytest.mark.parametrize(
    ("real", "simulated", "limit", "passed"),
    [
        (None, 0.40, 0.40, True),
        (None, 0.41, 0.40, False),
        (0.5, 0.74, 1.5, True),
        (0.5, 0.76, 1.5, False),
        (0.5, 0.34, 1.5, True),
        (0.5, 0.33, 1.5, False),
        (0.0, 0.01, None, None),
    ],
)
def test_a_figure_passes_within_its_limit_either_way(
    real: float | None, simulated: float, limit: float | None, passed: bool | None
) -> None:
    metric = CalibrationMetric(joint="x", quantity="y", real=real, simulated=simulated, limit=limit)
    assert metric.passed is passed


def test_the_closed_form_is_eq_11_in_a_steady_ramp() -> None:
    drive = DriveValues(stiffness=50.0, friction=0.5)
    found = ramp_error(drive, 1.5, 0.036, table([[0.0] * 3] * 2))
    expected = [[-0.036 - 2.0 / 50, 0.036 + 2.0 / 50], [-0.036, 0.036 + 4.0 / 50]]
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize("delay", [2, 4])
def test_a_table_of_the_closed_form_gives_its_values_and_delay_back(delay: int) -> None:
    real = synthetic(delay)
    for joint, name in (("RShoulderRoll", "LShoulderRoll"), ("RElbowRoll", "RElbowRoll")):
        found = closed_form_fit(
            real.recordings.tables[name], drag(ROBOT, NOMINAL, joint), delay * ROBOT.cycle
        )
        assert found.stiffness == pytest.approx(TRUE[joint].stiffness, rel=1e-3)
        assert found.friction == pytest.approx(TRUE[joint].friction, rel=1e-3)
    values, ticks = start_values(ROBOT, NOMINAL, targets(real))
    assert ticks == delay
    # K of a joint with holds only: holding torque over error.
    assert values["RShoulderPitch"].stiffness == pytest.approx(118.0, rel=0.02)
    assert values["RWristYaw"].stiffness == pytest.approx(0.6, rel=1e-3)


def test_holds_are_predicted_from_the_ratio_to_friction() -> None:
    before = DriveValues(stiffness=100.0, friction=1.0)
    load, ratio = np.array([2.0, -1.0, 0.3]), np.array([1.0, -0.5, -1.0])
    error = (load + 1.0 * ratio) / 100.0
    softer = DriveValues(stiffness=50.0, friction=0.5)
    band = replace(before, dead_band=0.01)
    found, current = predict_holds(before, [before, softer, band], error, load, 2.0)
    motor = load + 0.5 * ratio
    np.testing.assert_allclose(found[0], error)
    np.testing.assert_allclose(found[1], motor / 50.0)
    np.testing.assert_allclose(found[2], error + 0.01 * np.sign(error))
    np.testing.assert_allclose(current[1], np.abs(motor) / 2.0)


def test_room_is_to_the_nearest_target() -> None:
    target = next(t for t in targets(REAL) if t.joint == "RElbowRoll")
    found = score(ROBOT, target, target.max_residual * 0.98, target.holds)
    assert found.room == pytest.approx(1.0)  # one standard deviation below the residual's limit
    far = replace(target.holds, median_deg=target.holds.median_deg * 1.5)
    assert score(ROBOT, target, 0.0, far).room == pytest.approx(0.0)
    assert score(ROBOT, target, 0.0, far).squares > found.squares


def test_a_plant_gets_the_values_on_both_arms_and_its_file_says_the_same(tmp_path: Path) -> None:
    plant = with_values(ROBOT, NOMINAL, TRUE, 4)
    for joint, values in TRUE.items():
        for side in (joint, "L" + joint[1:]):
            found = values_of(ROBOT, plant, side)
            assert found.stiffness == pytest.approx(values.stiffness, rel=1e-3)
            assert found.friction == pytest.approx(values.friction, rel=1e-3)
            assert found.dead_band == pytest.approx(values.dead_band, rel=1e-3)
            drive, old = plant.actuator(side), NOMINAL.actuator(side)
            assert drive.kd / drive.kp == pytest.approx(old.kd / old.kp, rel=1e-3)
            assert "kp" in drive.origin["calibrated"]
    head = values_of(ROBOT, plant, "HeadPitch")
    assert head.stiffness == pytest.approx(TRUE["RElbowRoll"].stiffness, rel=1e-3)
    assert plant.response_delay == 4
    for joint in ("HipPitch", "LHand"):
        assert values_of(ROBOT, plant, joint) == values_of(ROBOT, NOMINAL, joint)
    path = tmp_path / "mine.yaml"
    path.write_text(plant_text(NOMINAL, plant, name="mine", extends="nominal", comment="a\nb"))
    loaded = load_plant(str(path), ROBOT)
    one_joint_each = with_values(ROBOT, loaded, {})  # as the written plant has it
    assert plant_hash(one_joint_each, ROBOT) == plant_hash(plant, ROBOT)


def test_an_integral_part_is_kept_in_the_file(tmp_path: Path) -> None:
    start = load_plant("integral", ROBOT)
    value = DriveValues(stiffness=44.0, friction=0.3, integral_time=2.0)
    plant = with_values(ROBOT, start, {"RShoulderRoll": value})
    path = tmp_path / "slow.yaml"
    path.write_text(plant_text(start, plant, name="slow", extends="integral", comment=""))
    found = values_of(ROBOT, load_plant(str(path), ROBOT), "LShoulderRoll")
    assert found.integral_time == pytest.approx(2.0, rel=1e-3)
    assert found.stiffness == pytest.approx(44.0, rel=1e-3)


def test_the_fit_recovers_a_made_up_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "measure", model_bench)
    reported: list[float] = []
    found = fit_pd(ROBOT, NOMINAL, synthetic(2), progress=reported.append)
    assert found.delay == 2
    for joint, true in TRUE.items():
        # Values are tried in steps, K by 4 %, F / K by 0.025 deg, the dead band by 0.1 deg: one makes up for another.
        values = found.values[joint]
        assert values.stiffness == pytest.approx(true.stiffness, rel=0.1), joint
        assert values.dead_band == pytest.approx(true.dead_band, abs=np.radians(0.11)), joint
        reach = np.degrees(values.friction / values.stiffness + values.dead_band)
        expected = np.degrees(true.friction / true.stiffness + true.dead_band)
        assert reach == pytest.approx(expected, abs=0.08), joint
        assert found.room[joint] > 2.0
        assert values_of(ROBOT, found.plant, joint) == values
    assert reported == sorted(reported)


def test_a_fit_never_does_worse_than_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "measure", model_bench)
    poor = {joint: replace(v, stiffness=3 * v.stiffness) for joint, v in TRUE.items()}
    monkeypatch.setattr(fit, "choose", lambda *given: (poor, 3))
    start = with_values(ROBOT, NOMINAL, TRUE, 3)
    reported: list[float] = []
    found = fit_pd(ROBOT, start, synthetic(3), progress=reported.append)
    for joint in TRUE:
        assert found.values[joint] == values_of(ROBOT, start, joint)
    assert reported[-1] == pytest.approx(1.0)


def ratios(joint: str) -> tuple[FloatArray, FloatArray]:
    """Loads [N m] of made-up holds, and the ratios to friction they stick at."""
    rng = np.random.default_rng(list(TRUE).index(joint))
    size = 0.006 if joint == "RWristYaw" else 1.5 * TRUE[joint].friction
    return size * rng.uniform(-1, 1, 200), rng.choice([-1.0, 1.0], 200) * rng.uniform(0.6, 1.0, 200)


def modelled_holds(joint: str, values: DriveValues) -> tuple[NDArray[Any], NDArray[Any]]:
    load, ratio = ratios(joint)
    motor = load + values.friction * ratio
    error = motor / values.stiffness + values.dead_band * np.sign(motor)
    current = np.abs(motor) / ROBOT.motors.joint_torque_constant(joint)
    return error, current * (joint != "RWristYaw")


def model_bench(
    robot: RobotConfig, plant: PlantConfig, calibration: Calibration, seed: int, **rest: Any
) -> BenchResult:
    """Stands in for the simulation: closed forms."""
    rest["progress"](1.0)
    holds = {j: modelled_holds(j, values_of(robot, plant, j)) for j in TRUE}
    tables = {
        name: ramp_error(
            values_of(robot, plant, name),
            drag(robot, plant, name),
            plant.response_delay * robot.cycle,
            expected,
        )
        for name, expected in calibration.recordings.tables.items()
    }
    return BenchResult(
        tables=tables,
        holds=HoldEnds(
            joints=tuple(TRUE),
            error=np.stack([error for error, _ in holds.values()], axis=1),
            current=np.stack([current for _, current in holds.values()], axis=1),
            load=np.stack([ratios(joint)[0] for joint in TRUE], axis=1),
        ),
    )


def synthetic(delay: int) -> Calibration:
    """Recordings of the made-up robot, to as many digits as there are."""
    plant = with_values(ROBOT, NOMINAL, TRUE, delay)
    measured = model_bench(ROBOT, plant, REAL, 0, progress=lambda fraction: None)
    tables = {}
    for name, real in REAL.recordings.tables.items():
        rows = np.zeros((len(real.torque), len(real.velocity)))
        rows[:, np.array(real.velocity) != 0.0] = np.degrees(measured.tables[name])
        tables[name] = replace(real, expected_error_deg=tuple(tuple(row.tolist()) for row in rows))
    holds = {joint: statistics(measured.holds, joint) for joint in TRUE}
    return replace(REAL, recordings=replace(REAL.recordings, tables=tables, holds=holds))


def report(**changes: Any) -> CalibrationReport:
    parts: dict[str, Any] = {
        "plant": "made-up",
        "law": "pd",
        "measured": model_bench(ROBOT, NOMINAL, REAL, 0, progress=lambda fraction: None),
        "chases": ChaseReport(
            figures=REAL.recordings.chases.figures,
            false_contacts=FalseContacts(
                count=2, minutes=60.0, by_joint={"RWristYaw": 2}, blind=0.1
            ),
            identified_on="a robot",
            real=REAL.recordings.chases,
            settings=REAL.settings,
        ),
        "reference_error": 0.25e-3,
        "real_time_factor": 12.0,
        "calibration": REAL,
    }
    return CalibrationReport(**parts | changes)


def test_the_json_has_the_agreed_keys() -> None:
    metrics = json.loads(json.dumps(report().as_json()))
    assert set(metrics["residual_deg"]) == {"LShoulderRoll", "RElbowRoll"}
    assert set(metrics["hold_deg"]) == set(TRUE)
    assert all(set(entry) == {"median", "p90"} for entry in metrics["hold_deg"].values())
    assert metrics["reference_error_mrad"] == pytest.approx(0.25)
    assert metrics["real_time_factor"] == 12.0
    roll = metrics["hold_deg"]["RShoulderRoll"]["median"]
    assert metrics["hold_factor"]["RShoulderRoll"]["median"] == pytest.approx(roll / 0.67)
    assert metrics["hold_current_a"]["RWristYaw"] == {"median": 0.0, "p90": 0.0}


def test_the_figure_compares_joints_on_one_scale() -> None:
    measured = report()
    figure = calibration_figure(measured)
    titles = [axes.get_title() for axes in figure.get_axes() if axes.get_title()]
    tables, holds = REAL.recordings.tables, REAL.recordings.holds
    assert len(titles) == 2 * len(tables) + len(holds)
    for joint in (*tables, *holds):
        assert any(title.startswith(joint_title(joint)) for title in titles)
    shown = [axes for axes in figure.get_axes() if "simulated, " in axes.get_title()]
    assert len(shown) == len(holds)
    for kind in (shown, [axes for axes in figure.get_axes() if "cells" in axes.get_title()]):
        assert len({axes.get_ylim() for axes in kind}) == 1
    assert len({axes.get_xlim() for axes in shown}) == 1
    count = len(measured.measured.holds.error)
    assert all(
        f"n = {count} simulated, {REAL.recordings.hold_count} real" in a.get_title() for a in shown
    )
    pictures = [axes.images[0] for axes in figure.get_axes() if axes.images]
    assert len({picture.get_clim() for picture in pictures}) == 1, "one colour, one difference"
    (legend,) = (legend for part in figure.subfigs for legend in part.legends)
    labels = [text.get_text() for text in legend.get_texts()]
    assert len(labels) == len(set(labels))
    assert {"simulated", "a match"} < set(labels)


@pytest.mark.parametrize("efficiency", [1.0, 0.5])
def test_the_values_of_a_drive_are_those_at_the_joint(efficiency: float) -> None:
    """A gear that passes on half the torque halves stiffness and back-EMF; what is set is read again."""
    joint = "RElbowRoll"
    drives = [
        replace(drive, efficiency=efficiency) if joint in drive.joints else drive
        for drive in with_values(ROBOT, NOMINAL, {}).actuators
    ]
    plant = replace(NOMINAL, actuators=tuple(drives))
    constant, motor = ROBOT.motors.joint_torque_constant(joint), ROBOT.motors.of(joint)
    drive = plant.actuator(joint)
    assert values_of(ROBOT, plant, joint).stiffness == pytest.approx(
        efficiency * drive.kp * constant / motor.resistance
    )
    viscous = drag(ROBOT, plant, joint) - efficiency * constant**2 / motor.resistance
    assert viscous == pytest.approx(drag(ROBOT, NOMINAL, joint) - constant**2 / motor.resistance)
    boards = MotorBoards(ROBOT, plant)
    index = ROBOT.joint_index(joint)
    assert boards.stiffness[index] == pytest.approx(values_of(ROBOT, plant, joint).stiffness)
    full = MotorBoards(ROBOT, NOMINAL).torque_limit[index]
    assert boards.torque_limit[index] == pytest.approx(efficiency * full)
    expected = DriveValues(stiffness=77.0, friction=0.6)
    changed = with_values(ROBOT, plant, {joint: expected})
    assert values_of(ROBOT, changed, joint).stiffness == pytest.approx(77.0, rel=1e-3)


def test_a_report_passes_when_every_limit_is_kept() -> None:
    same = synthetic(3)
    plant = with_values(ROBOT, NOMINAL, TRUE, 3)
    measured = model_bench(ROBOT, plant, same, 0, progress=lambda fraction: None)
    assert report(measured=measured, calibration=same).passed
    late = with_values(ROBOT, NOMINAL, TRUE, 6)
    measured = model_bench(ROBOT, late, same, 0, progress=lambda fraction: None)
    assert not report(measured=measured, calibration=same).passed


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[str]], int]:
    """The command on a bench with few cells and goals, in this process."""
    tables = {
        name: TrackingTable(velocity=(-0.5, 0.5), torque=(0.0,), expected_error_deg=((-1.5, 1.5),))
        for name in REAL.recordings.tables
    }
    short = replace(REAL.settings.ramps, wait=0.1, time=0.3, arrival_time=0.1)
    small = replace(
        REAL,
        recordings=replace(REAL.recordings, tables=tables),
        settings=replace(
            REAL.settings,
            ramps=short,
            fit_count=2,
            chases=replace(REAL.settings.chases, count=2, move=(0.2, 0.3), hold=0.7),
        ),
        holds=replace(REAL.holds, count=2, move=0.2, hold=0.1),
    )
    monkeypatch.setattr(command, "load_calibration", lambda robot: small)
    monkeypatch.setattr(calibrate, "integration_error", lambda robot, plant: 2e-4)
    monkeypatch.setattr(calibrate, "real_time_factor", lambda robot, plant: 10.0)
    return lambda arguments: run(["calibrate", "--workers", "1", *arguments])


def test_check_measures_and_writes_figures(
    tiny: Callable[[list[str]], int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metrics, picture = tmp_path / "metrics.json", tmp_path / "picture.png"
    assert tiny(["--check", "--json", str(metrics), "--plot", str(picture)]) == 0
    content = json.loads(metrics.read_text())
    assert content["plant"] == "nominal"
    assert "fit" not in content
    assert 0.0 < content["residual_deg"]["RElbowRoll"] < 5.0
    assert picture.read_bytes().startswith(b"\x89PNG")
    shown = capsys.readouterr().out
    assert "RWristYaw" in shown
    assert "pass" in shown
    assert "in simulation" in shown
    assert "commands as recorded" in shown
    assert "of 20 judged cells hold" in shown
    assert "false contacts with models identified on " in shown
    assert len(content["as_recorded"]["cells"]) == 20


@pytest.mark.parametrize("law", ["pd", "integral"])
def test_a_fit_writes_a_plant_that_loads(
    law: str, tiny: Callable[[list[str]], int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, metrics = tmp_path / "mine.yaml", tmp_path / "metrics.json"
    assert tiny(["--control-law", law, "--out", str(out), "--json", str(metrics)]) == 0
    content = json.loads(metrics.read_text())
    plant = load_plant(str(out), ROBOT)
    for joint, values in content["fit"]["joints"].items():
        found = values_of(ROBOT, plant, joint)
        assert found.stiffness == pytest.approx(values["stiffness"], rel=1e-3)
        expected = inf if values["integral_time"] is None else values["integral_time"]
        assert found.integral_time == pytest.approx(expected, rel=1e-3)
    assert content["law"] == law
    assert plant.response_delay == content["fit"]["delay_ticks"]
    assert "plant: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--check", "--plant", "nominl"], "did you mean nominal"),
        (["--check", "--plant", "missing.yaml"], "missing.yaml"),
        (["--control-law", "pid"], "must be pd or integral, got 'pid'"),
        (["--plant", "random"], "drawn again"),
        (["--control-law", "integral", "--plant", "nominal"], "no board has an integral part"),
        (["--out", "/dev/null/x.yaml"], "/dev/null/x.yaml"),
        (["--out", "plant.txt"], ".yaml"),
        (["--check", "--out", "x.yaml"], "--check"),
        (["--check", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["--check", "--plot", "x.bmp"], "bmp"),
        (["--check", "--workers", "0"], "workers"),
    ],
)
def test_a_wrong_input_is_one_line_and_code_2(
    arguments: list[str],
    word: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["calibrate", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("pepper: ")
    assert word in lines[0]
    assert list(tmp_path.iterdir()) == [], "nothing half-written"


def test_hold_statistics_compare_like_with_like() -> None:
    """The metrics of a report are the real ones next to those of the same joint."""
    metrics = {(f.joint, f.quantity): f for f in report().metrics}
    for joint, real in REAL.recordings.holds.items():
        assert isinstance(real, HoldStatistics)
        assert metrics[joint, "p90"].real == real.p90_deg
        assert metrics[joint, "current median"].real == real.current[0]
        assert metrics[joint, "current p90"].limit is None
