"""Findings of the doctor on robots that do not move."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import DeviceError, Measurement, NotConnectedError
from pepper_driver.backends.mock import Fault
from pepper_driver.config import (
    PepperError,
    RobotIdentity,
    load_controller_settings,
    load_safety_settings,
)
from pepper_driver.doctor import CheckStatus, examine
from pepper_driver.doctor.checks import check_computer, check_models, check_settings
from pepper_driver.observer import ModelSet
from pepper_driver.observer.models.model_file import shipped
from pepper_driver.testing import aged, displaced, drained, heated, pressed
from support.doctor import (
    ROBOT,
    Patient,
    examined,
    field,
    held,
    inertial,
    lost,
    models_for,
    named,
    only,
    passing_clock,
    shifted_clock,
)
from support.fusion import fusion_model

SAFETY = load_safety_settings()
HEAD, ROLL = ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("LShoulderRoll")
OK, WARNING, FAILED, UNKNOWN = (
    CheckStatus.OK,
    CheckStatus.WARNING,
    CheckStatus.FAILED,
    CheckStatus.UNKNOWN,
)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return models_for("mock", tmp_path_factory.mktemp("models"))


def test_a_robot_that_is_well_passes_and_was_never_moved(
    monkeypatch: pytest.MonkeyPatch, models: Path
) -> None:
    patient = Patient()
    examination = examined(monkeypatch, patient, models)
    assert examination.passed
    statuses = {result.name: result.status for result in examination.results}
    unknown = {name for name, status in statuses.items() if status is UNKNOWN}
    assert unknown == {"diagnosis", "charging flap"}
    assert {o for n, o in statuses.items() if n not in unknown} == {OK}
    assert all(not result.remedy for result in examination.results)
    assert patient.calls == ["open", "close"]
    assert not patient.commands, "it is read from, and gets no command"


@pytest.mark.parametrize(
    ("sickness", "check", "status", "word"),
    [
        (lost(HEAD), "joints", FAILED, "HeadYaw"),
        (held(HEAD, ROBOT.upper[HEAD] + 0.02), "limits", WARNING, "1.1 deg beyond"),
        (held(HEAD, ROBOT.upper[HEAD] + 0.1), "limits", FAILED, "5.7 deg beyond"),
        (held(ROLL, ROBOT.lower[ROLL] - 0.1), "limits", FAILED, "LShoulderRoll"),
        (held(HEAD, ROBOT.upper[HEAD] + 0.005), "limits", OK, "0.3 deg beyond"),
        (heated("HeadYaw", SAFETY.temperature_fault), "temperatures", FAILED, "HeadYaw"),
        (heated("HeadYaw", SAFETY.temperature_warning), "temperatures", WARNING, "68"),
        (heated("HeadYaw", SAFETY.temperature_warning - 1), "temperatures", OK, "67"),
        (heated("HeadYaw", np.nan), "temperatures", WARNING, "unknown: HeadYaw"),
        (field("temperature", np.full(17, np.nan)), "temperatures", UNKNOWN, "no motor"),
        (drained(SAFETY.battery_activate - 0.01), "battery", FAILED, "9%"),
        (drained(SAFETY.battery_warning - 0.01), "battery", WARNING, "19%"),
        (drained(np.nan), "battery", UNKNOWN, "cannot be read"),
        (field("charging_flap", 1.0), "charging flap", WARNING, "open"),
        (field("charging_flap", 0.0), "charging flap", OK, "closed"),
        (field("wheel_speed", np.array([0.0, 0.5, 0.0])), "wheels", FAILED, "0.50 rad/s"),
        (field("wheel_speed", np.array([0.0, np.nan, 0.0])), "wheels", FAILED, "no speed"),
        (pressed("bumpers", 2), "bumpers", FAILED, "Back"),
        (field("bumpers", np.array([np.nan, 0.0, 0.0])), "bumpers", FAILED, "FrontLeft"),
        (pressed("buttons"), "chest button", FAILED, "ChestBoard/Button"),
        (pressed("touch", 1), "touch sensors", WARNING, "Head/Touch/Middle"),
        (inertial(attitude=np.array([0.0, 0.2, 0.0])), "inertial unit", FAILED, "11.5 deg"),
        (inertial(attitude=np.array([0.08, 0.0, 2.0])), "inertial unit", WARNING, "4.6 deg"),
        (inertial(attitude=np.array([0.0, 0.0, 2.0])), "inertial unit", OK, "0.0 deg"),
        (inertial(attitude=np.full(3, np.nan)), "inertial unit", FAILED, "does not answer"),
        (inertial(acceleration=np.zeros(3)), "inertial unit", WARNING, "gravity 0.00"),
        (aged(SAFETY.stale_hold + 0.001), "samples", FAILED, "81 ms"),
        (aged(0.04), "samples", WARNING, "40 ms"),
        (aged(np.nan), "samples", FAILED, "not known"),
        (field("time", np.nan), "clock", FAILED, "not a number"),
        (field("tick", 5), "clock", FAILED, "no new sample"),
    ],
)
def test_each_sickness_is_found_with_what_to_do_and_nothing_moves(
    sickness: Fault,
    check: str,
    status: CheckStatus,
    word: str,
    models: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    patient = Patient(sickness)
    examination = examined(monkeypatch, patient, models)
    result = named(examination, check)
    assert (result.status, word in result.found) == (status, True), result
    assert bool(result.remedy) == (status in (WARNING, FAILED))
    assert examination.passed == (status is not FAILED)
    assert not patient.moved


@pytest.mark.parametrize(
    ("sickness", "check", "status", "word"),
    [
        (shifted_clock(0.5), "clock", FAILED, "jumps by 0.512 s"),
        (shifted_clock(-0.5), "clock", FAILED, "goes back by 0.488 s"),
        (shifted_clock(0.005), "clock", OK, "off by 5.0 ms"),
        (displaced("HeadYaw", 0.05), "joints", WARNING, "2.9 deg"),
        (aged(0.09), "samples", FAILED, "90 ms"),
        (aged(0.04), "samples", OK, "at most 40 ms"),
        (pressed("bumpers"), "bumpers", FAILED, "FrontLeft"),
    ],
)
def test_what_happens_once_is_seen_too(
    sickness: Fault,
    check: str,
    status: CheckStatus,
    word: str,
    models: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result = named(examined(monkeypatch, Patient(sickness, tick=100), models), check)
    assert (result.status, word in result.found) == (status, True), result


def test_a_clock_with_another_cycle_is_found(monkeypatch: pytest.MonkeyPatch, models: Path) -> None:
    def slow(measurement: Measurement) -> Measurement:
        return replace(measurement, time=1.1 * measurement.time)

    result = named(examined(monkeypatch, Patient(slow), models), "clock")
    assert result.status is FAILED
    assert "13.20 ms" in result.found


def test_in_real_time_the_rates_of_both_clocks_are_compared(
    monkeypatch: pytest.MonkeyPatch, models: Path
) -> None:
    patient = Patient(real_time=True)
    patient.clock = passing_clock(oversleep=ROBOT.cycle)
    result = named(examined(monkeypatch, patient, models), "clock")
    assert result.status is WARNING
    assert "0.50" in result.found


@pytest.mark.parametrize(
    ("errors", "status"),
    [
        ((), OK),
        ((DeviceError(device="LHand", text="no answer", serious=False),), WARNING),
        ((DeviceError(device="LHand", text="no answer", serious=True),), FAILED),
    ],
)
def test_the_robots_own_diagnosis_counts(
    errors: tuple[DeviceError, ...],
    status: CheckStatus,
    models: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result = named(examined(monkeypatch, Patient(errors=errors), models), "diagnosis")
    assert result.status is status
    assert all(f"{error.device}: {error.text}" in result.found for error in errors)


def test_a_robot_that_is_not_there_is_a_failure_with_a_cure(
    monkeypatch: pytest.MonkeyPatch, models: Path
) -> None:
    def refuse() -> None:
        raise NotConnectedError("no robot at pepper.local")

    examination = examined(monkeypatch, Patient(opens=refuse), models)
    assert [result.name for result in examination.results] == [
        "connection",
        "settings",
        "computer",
        "models",
    ]
    assert named(examination, "connection").status is FAILED
    assert "pepper.local" in named(examination, "connection").found
    assert not examination.passed


def test_a_robot_lost_while_it_is_looked_at_is_closed(
    monkeypatch: pytest.MonkeyPatch, models: Path
) -> None:
    def lose(measurement: Measurement) -> Measurement:
        raise NotConnectedError("the cable fell out")

    patient = Patient(lose, tick=50)
    assert "cable" in named(examined(monkeypatch, patient, models), "connection").found
    assert patient.calls == ["open", "close"]


def test_models_of_another_robot_are_a_failure(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    examination = examined(monkeypatch, Patient(), models_for("another", tmp_path))
    result = named(examination, "models")
    assert result.status is FAILED
    assert "identified on another robot" in result.found
    assert "pepper identify" in result.remedy
    assert examination.models is None


def test_a_robot_without_models_is_reported() -> None:
    result = named(examine("mock"), "models")
    assert result.status is FAILED
    assert "no models come with the package for 'mock'" in result.found
    assert "pepper identify" in result.remedy


def test_a_variant_has_the_models_of_the_plant_it_extends(caplog: pytest.LogCaptureFixture) -> None:
    result = named(examine("mujoco://?plant=worn"), "models")
    assert result.status is OK
    assert "identified on 'nominal', of which it is a variant" in result.found
    assert not caplog.records, "it is said once"


def test_models_that_lack_a_joint_or_are_of_another_version_are_warned_of() -> None:
    whole = ModelSet.load(shipped("fusion")["nominal"])
    own = [RobotIdentity(name="nominal", identity=whole.identity)]
    assert check_models(whole, own, ROBOT).status is OK
    old = check_models(replace(whole, version="0.0.1"), own, ROBOT)
    assert (old.status, "0.0.1" in old.found) == (WARNING, True)
    partial = check_models(only(whole, set(ROBOT.joint_names) - {"LHand"}), own, ROBOT)
    assert (partial.status, "LHand" in partial.remedy) == (WARNING, True)
    wrist = fusion_model(spread=(0.3, 0.3, 0.3))
    numb = check_models(replace(whole, models={**whole.models, "LWristYaw": wrist}), own, ROBOT)
    assert (numb.status, "no touch reaches the thresholds of LWristYaw" in numb.found) == (
        WARNING,
        True,
    )


def test_switched_off_protection_is_warned_of() -> None:
    controller = load_controller_settings(ROBOT)
    assert check_settings(SAFETY, controller).status is OK
    deaf = check_settings(replace(SAFETY, chest_button=False), controller)
    assert (deaf.status, "chest_button" in deaf.found) == (WARNING, True)
    constraints = replace(controller.constraints, self_collision=False)
    bare = check_settings(SAFETY, replace(controller, constraints=constraints))
    assert (bare.status, "self_collision" in bare.found) == (WARNING, True)
    assert check_settings(SAFETY, replace(controller, velocity="robot")).status is WARNING


@pytest.mark.parametrize(
    ("real_time", "obstacle", "status"),
    [(False, "no; do so", OK), (True, "", OK), (True, "not permitted; write a line", WARNING)],
)
def test_priority_matters_on_a_real_robot(
    real_time: bool, obstacle: str, status: CheckStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.doctor.checks.priority_obstacle", lambda: obstacle)
    result = check_computer(Patient(real_time=real_time))
    assert result.status is status
    assert result.remedy == ("write a line" if status is WARNING else "")


def test_a_wrong_uri_is_no_result_but_an_error() -> None:
    with pytest.raises(PepperError, match="did you mean worn"):
        examine("mujoco://?plant=worm")


@pytest.mark.parametrize("progress", [None, lambda fraction: None])
def test_the_simulated_robot_is_well(progress: Callable[[float], None] | None) -> None:
    examination = examine("mujoco://?seed=4", on_progress=progress)
    statuses = {result.status for result in examination.results}
    assert statuses == {OK, UNKNOWN}
    assert named(examination, "diagnosis").status is UNKNOWN
