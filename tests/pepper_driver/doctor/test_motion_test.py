"""The doctor's small motion: what it asks of the joints, and what it says of their models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pepper_driver.backends.mock import Fault
from pepper_driver.config import load_doctor_settings, load_self_collision
from pepper_driver.controller import RobotModel
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.doctor import CheckStatus, MotionTest, Verdict, try_motion
from pepper_driver.doctor import motion_test as motion_test_module
from pepper_driver.doctor.motion_test import NoRoomError, make_pepper, moving_joints, plan_goals
from pepper_driver.observer import ModelSet
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot
from pepper_driver.observer.models.model_file import shipped
from pepper_driver.robot import Pepper
from pepper_driver.testing import heated, pressed
from support.doctor import ROBOT, Patient, held, only, use
from support.examples import examples

SETTINGS = load_doctor_settings()
NOMINAL = ModelSet.load(shipped("fusion")["nominal"])
LEGS = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
MOVED = [ROBOT.joint_index(name) for name in moving_joints(ROBOT)]


def statuses(motion_test: MotionTest) -> dict[str, CheckStatus]:
    return {result.name: result.status for result in motion_test.results}


def found(motion_test: MotionTest, name: str) -> str:
    return next(result.found for result in motion_test.results if result.name == name)


def tried(uri: str, models: ModelSet = NOMINAL) -> MotionTest:
    return try_motion(make_pepper(uri, models, ROBOT), models)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight goals instead of sixteen."""
    settings = replace(SETTINGS, motion=SETTINGS.motion / 2)
    monkeypatch.setattr(motion_test_module, "load_doctor_settings", lambda: settings)


# -- what moves -------------------------------------------------------------------------------------------------------


@examples(30)
@given(fractions=st.lists(st.floats(0.0, 1.0), min_size=17, max_size=17))
def test_goals_are_within_the_limits_from_any_posture_and_legs_stand(
    fractions: list[float],
) -> None:
    start = ROBOT.lower + np.array(fractions) * (ROBOT.upper - ROBOT.lower)
    try:
        goals = np.array(plan_goals(start, ROBOT, SETTINGS))
    except NoRoomError:
        assume(False)
    inside = goals[:-1, MOVED]
    room = SETTINGS.limit_distance - 1e-9
    assert (inside >= ROBOT.lower[MOVED] + room).all()
    assert (inside <= ROBOT.upper[MOVED] - room).all()
    assert (goals[:, LEGS] == start[LEGS]).all()
    np.testing.assert_array_equal(goals[-1], start)
    amplitude = max(SETTINGS.amplitude, SETTINGS.hand_amplitude)
    largest = 2 * amplitude + SETTINGS.limit_distance + max(SETTINGS.clearance_motion.values())
    assert (np.abs(goals - start) <= largest + 1e-9).all()


@pytest.mark.parametrize("posture", ROBOT.postures)
def test_arms_keep_their_distance_from_the_body(posture: str) -> None:
    goals = plan_goals(np.clip(ROBOT.posture(posture), ROBOT.lower, ROBOT.upper), ROBOT, SETTINGS)
    model = RobotModel(ROBOT)
    capsules = CapsuleDistances(model, load_self_collision(ROBOT))
    for goal in goals[:-1]:
        capsules.place(model.configuration(goal))
        assert capsules.distances().min() >= SETTINGS.clearance


def test_a_posture_without_room_is_refused() -> None:
    crossed = ROBOT.posture("Stand")
    before = {"ShoulderPitch": 0.9, "ElbowYaw": 0.5, "ElbowRoll": 1.5}  # hands in one another
    for joint, angle in before.items():
        mirrored = joint != "ShoulderPitch"
        crossed[ROBOT.joint_index(f"R{joint}")] = angle
        crossed[ROBOT.joint_index(f"L{joint}")] = -angle if mirrored else angle
    with pytest.raises(NoRoomError, match="by hand"):
        plan_goals(crossed, ROBOT, SETTINGS)


def test_all_of_arms_and_head_move_by_a_few_degrees_for_the_given_time() -> None:
    assert len(MOVED) == 14
    start = ROBOT.posture("Stand")
    goals = np.array(plan_goals(start, ROBOT, SETTINGS))
    assert len(goals) * SETTINGS.segment_time == pytest.approx(
        SETTINGS.motion, abs=SETTINGS.segment_time
    )
    turns = np.diff(np.sign(goals[1:-1, MOVED] - goals[0, MOVED]), axis=0)
    assert (turns != 0).all(), "from one side of the middle to the other each time"
    assert (np.ptp(goals[:, MOVED], axis=0) > SETTINGS.amplitude).all()


# -- what it says -----------------------------------------------------------------------------------------------------


def test_the_simulated_robot_fits_its_models() -> None:
    motion_test = tried("mujoco://?seed=11")
    assert motion_test.passed
    assert set(statuses(motion_test).values()) == {CheckStatus.OK}
    assert {fit.verdict for fit in motion_test.fits} == {Verdict.FITS}
    # With room: the worst is at a third of what counts as worn. Single ticks come closer to it.
    assert max(fit.rms for fit in motion_test.fits) < 0.5 * SETTINGS.worn_rms
    assert max(fit.peak for fit in motion_test.fits) < 0.9 * SETTINGS.worn_peak
    assert motion_test.fits[0].as_json()["verdict"] == "fits"


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("before", "status"),
    [
        (3, CheckStatus.OK),
        (4, CheckStatus.WARNING),
        (1, CheckStatus.FAILED),
        (9, CheckStatus.FAILED),
    ],
)
def test_a_delay_that_is_not_that_of_the_models_is_found(before: int, status: CheckStatus) -> None:
    measured = MeasuredRobot(
        reported_delay=before,
        delay_error=0,
        delay_spread=(-1.0, 1.0),
        late=0.0,
        lost=0.0,
        weight=None,
        joints={},
    )
    motion_test = tried("mujoco", replace(NOMINAL, measured=measured))
    assert statuses(motion_test)["delay"] is status
    assert found(motion_test, "delay").startswith("3 ticks from a command to its answer, ")
    assert f"{before} when the models were identified" in found(motion_test, "delay")
    assert motion_test.passed == (status is not CheckStatus.FAILED)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({}, CheckStatus.OK),
        ({"encoder_noise": 0.0044}, CheckStatus.WARNING),
        ({"late": 0.25, "longest_late": 2}, CheckStatus.WARNING),
    ],
)
def test_sensors_that_are_worse_than_before_are_found(
    change: dict[str, float], status: CheckStatus, tmp_path: Path
) -> None:
    plant = tmp_path / "worse.yaml"
    plant.write_text(
        f"name: worse\ndescription: worse sensors\nextends: nominal\ntransport: {change}\n"
        if change
        else "name: worse\ndescription: the same\nextends: nominal\n"
    )
    quiet = MeasuredJoint(encoder_noise=0.0003, current_noise=0.01)
    measured = MeasuredRobot(
        reported_delay=3,
        delay_error=0,
        delay_spread=(-1.0, 1.0),
        late=0.02,
        lost=0.0,
        weight=None,
        joints=dict.fromkeys(ROBOT.joint_names, quiet),
    )
    motion_test = tried(f"mujoco://?plant={plant}", replace(NOMINAL, measured=measured))
    assert statuses(motion_test)["sensors"] is status


@pytest.mark.usefixtures("brief")
def test_a_robot_without_currents_shows_no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, Patient())
    motion_test = tried("mock")
    assert statuses(motion_test)["delay"] is CheckStatus.UNKNOWN


@pytest.mark.usefixtures("brief")
def test_a_worn_robot_must_be_identified_again() -> None:
    motion_test = tried("mujoco://?plant=worn")
    # Its friction is half as large again: models of a new robot would give false contacts.
    assert statuses(motion_test)["models fit"] is CheckStatus.FAILED
    changed = [f.joint for f in motion_test.fits if f.verdict in (Verdict.WORN, Verdict.MISFIT)]
    assert len(changed) > 4
    assert "LShoulderPitch" in changed


@pytest.mark.usefixtures("brief")
def test_a_load_in_a_hand_shows_on_its_arm_alone() -> None:
    motion_test = tried("mujoco://?plant=payload")
    assert statuses(motion_test)["models fit"] is CheckStatus.WARNING
    loaded = {f.joint for f in motion_test.fits if f.verdict in (Verdict.WORN, Verdict.MISFIT)}
    assert "LWristYaw" in loaded
    assert not any(joint.startswith(("R", "Head")) for joint in loaded)


@pytest.mark.usefixtures("brief")
def test_models_of_another_robot_do_not_fit(tmp_path: Path) -> None:
    plant = tmp_path / "rough.yaml"
    parts = (
        f"friction.{state}.{side}: 3.0"
        for state in ("contact", "gap")
        for side in ("motor", "link")
    )
    plant.write_text(
        f"name: rough\ndescription: dry\nextends: nominal\nfactors: {{{', '.join(parts)}}}\n"
    )
    motion_test = tried(f"mujoco://?plant={plant}")
    assert statuses(motion_test)["models fit"] is CheckStatus.FAILED
    assert "not of this robot" in found(motion_test, "models fit")
    assert not motion_test.passed


@pytest.mark.usefixtures("brief")
def test_a_touch_meanwhile_is_reported() -> None:
    pepper = make_pepper("mujoco", NOMINAL, ROBOT)
    fractions = []

    def push(fraction: float) -> None:
        fractions.append(fraction)
        if len(fractions) == 5:
            pepper.push("LForeArm", [0.0, 25.0, 0.0], duration=0.6)

    motion_test = try_motion(pepper, NOMINAL, on_progress=push)
    assert statuses(motion_test)["untouched"] is CheckStatus.FAILED
    assert "detected" in found(motion_test, "untouched")
    assert fractions[-1] == 1.0


@pytest.mark.usefixtures("brief")
def test_a_joint_that_stands_still_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    head = ROBOT.joint_index("HeadYaw")
    patient = Patient(held(head, float(ROBOT.posture("Stand")[head])))
    use(monkeypatch, patient)
    motion_test = tried("mock")
    assert statuses(motion_test)["joints follow"] is CheckStatus.FAILED
    assert "HeadYaw" in next(r.remedy for r in motion_test.results if r.name == "joints follow")
    stuck = [fit.joint for fit in motion_test.fits if fit.verdict is Verdict.STUCK]
    assert stuck == ["HeadYaw"]


@pytest.mark.usefixtures("brief")
def test_only_joints_of_arms_and_head_are_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    patient = Patient()
    use(monkeypatch, patient)
    motion_test = tried("mock")
    assert statuses(motion_test)["motion"] is CheckStatus.OK
    sent = np.array([command.position for command in patient.commands])
    np.testing.assert_allclose(sent[:, LEGS], np.broadcast_to(sent[0, LEGS], (len(sent), 3)))
    assert (np.ptp(sent[:, MOVED], axis=0) > SETTINGS.amplitude).all()
    assert not any(command.wheel_speed.any() for command in patient.commands)
    assert patient.calls[-1] == "close"


@pytest.mark.usefixtures("brief")
def test_the_bar_is_full_when_the_robot_stands_again(monkeypatch: pytest.MonkeyPatch) -> None:
    patient = Patient()
    use(monkeypatch, patient)
    fractions: list[float] = []
    times: list[float] = []

    def note(fraction: float) -> None:
        fractions.append(fraction)
        times.append(len(patient.commands) * ROBOT.cycle)

    try_motion(make_pepper("mock", NOMINAL, ROBOT), NOMINAL, on_progress=note)
    assert fractions[-1] == 1.0
    # A bar that runs as time does: 1 s of the motion is as much at its begin as at its end.
    passed, shown = (
        (np.array(values) - values[0]) / (values[-1] - values[0]) for values in (times, fractions)
    )
    assert np.abs(passed - shown).max() < 0.05


@pytest.mark.parametrize(
    ("sickness", "tick", "word"),
    [(pressed("buttons"), 500, "chest"), (heated("HeadYaw", 90.0), None, "not ready to move")],
)
def test_a_robot_that_is_stopped_meanwhile_is_a_result(
    sickness: Fault, tick: int | None, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    patient = Patient(sickness, tick=tick)
    use(monkeypatch, patient)
    motion_test = tried("mock")
    assert statuses(motion_test) == {"motion": CheckStatus.FAILED}
    assert word in found(motion_test, "motion")
    assert motion_test.fits == ()
    assert patient.calls[-1] == "close"


@pytest.mark.usefixtures("brief")
def test_a_joint_without_a_model_follows_and_is_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, Patient())
    motion_test = tried("mock", only(NOMINAL, {"LHand"}))
    verdicts = {fit.joint: fit.verdict for fit in motion_test.fits}
    assert verdicts["HeadYaw"] is Verdict.NO_MODEL
    assert motion_test.fits[0].as_json()["rms"] is None
    assert statuses(motion_test)["joints follow"] is CheckStatus.OK


@pytest.mark.usefixtures("brief")
def test_pepper_is_closed_after_an_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    patient = Patient()
    use(monkeypatch, patient)

    def interrupt(fraction: float) -> None:
        raise KeyboardInterrupt

    pepper: Pepper = make_pepper("mock", NOMINAL, ROBOT)
    with pytest.raises(KeyboardInterrupt):
        try_motion(pepper, NOMINAL, on_progress=interrupt)
    assert patient.calls[-1] == "close"
