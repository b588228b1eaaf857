"""ALMotion's writer on a robot without physics: its orders, their times, and what it leaves alone."""

from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends.naoqi_server.almotion.curves import Spline
from pepper_driver.backends.naoqi_server.almotion.joints import AlmotionTask
from pepper_driver.backends.naoqi_server.dcm import SPAN
from pepper_driver.config import ConfigError, load_naoqi_services
from pepper_driver.config.loading import package_file
from support.almotion import CONFIG, SETTINGS, Stage, angle_key, hardness_key, joint, wheel_key
from support.virtual_time import VirtualTime

ARM = SETTINGS.chains["LArm"]
LEG = SETTINGS.chains["Leg"]
WHEELS = {wheel_key(name) for name in CONFIG.wheels.names}


def interpolation(name: str, *points: tuple[float, float], what: str = "angle") -> AlmotionTask:
    """A task that takes a joint through (time, angle)."""
    times, values = [t for t, _ in points], [v for _, v in points]
    return AlmotionTask(
        name="test",
        what="angle" if what == "angle" else "stiffness",
        joints=frozenset({joint(name)}),
        make=lambda _, start: Spline(start, times, values),
    )


@pytest.fixture
def stage() -> Stage:
    """Stiff, and without a thread that writes by itself."""
    made = Stage()
    made.quiet()
    made.stiffen()
    return made


def test_a_target_is_reached_at_its_speed_and_smoothly(stage: Stage) -> None:
    speed = 0.1 * stage.motion.body.speed[joint("HeadYaw")]
    begin = stage.command("HeadYaw")
    stage.motion.joints.set_target(joint("HeadYaw"), 1.0, 0.1)
    stage.run(0.3 + (1.0 - begin) / speed + SETTINGS.rise)
    sent = np.array(stage.sent("HeadYaw"))
    rates = np.diff(sent) / 0.012
    assert sent[-1] == pytest.approx(1.0, abs=1e-6)
    assert rates.max() == pytest.approx(speed, rel=0.02)
    assert rates.min() > -1e-6
    # From one cycle of the DCM to the next, the speed changes by no more than two steps of ALMotion's.
    assert np.abs(np.diff(rates)).max() < 2.1 * speed / SETTINGS.rise * SETTINGS.cycle


def test_a_target_can_be_changed_on_the_way(stage: Stage) -> None:
    stage.motion.joints.set_target(joint("HeadYaw"), 1.0, 0.1)
    stage.run(0.8)
    turned = len(stage.sent("HeadYaw"))
    stage.motion.joints.set_target(joint("HeadYaw"), -0.5, 0.1)
    stage.run(4.0)
    rates = np.diff(stage.sent("HeadYaw")) / 0.012
    speed = 0.1 * stage.motion.body.speed[joint("HeadYaw")]
    assert stage.sent("HeadYaw")[-1] == pytest.approx(-0.5, abs=1e-6)
    assert np.abs(np.diff(rates))[turned - 5 :].max() < 2.1 * speed / SETTINGS.rise * SETTINGS.cycle


def test_targets_end_at_the_joints_limits(stage: Stage) -> None:
    stage.motion.joints.set_target(joint("HeadPitch"), 9.0, 1.0)
    stage.run(2.0)
    assert stage.sent("HeadPitch")[-1] == pytest.approx(CONFIG.upper[joint("HeadPitch")])


def test_an_interpolation_passes_its_points_in_time(stage: Stage) -> None:
    task = stage.add(interpolation("HeadYaw", (1.0, 0.5), (2.0, -0.5)))
    seen = {}
    begin = stage.robot.now

    def look() -> None:
        seen[stage.robot.now - begin] = stage.command("HeadYaw")

    stage.run(1.9, look)
    assert not task.over
    stage.run(0.2, look)
    assert task.over
    assert task.completed
    assert seen[1000] == pytest.approx(0.5, abs=0.01)
    assert max(seen.values()) == pytest.approx(0.5, abs=0.01)
    assert stage.command("HeadYaw") == -0.5


def test_too_fast_an_interpolation_goes_as_fast_as_the_joint_can(stage: Stage) -> None:
    task = stage.add(interpolation("HipPitch", (0.1, 0.9)))
    stage.run(0.2)
    assert not task.over
    stage.run(0.8)
    rates = np.diff(stage.sent("HipPitch")) / 0.012
    most = stage.motion.body.speed[joint("HipPitch")]
    assert np.abs(rates).max() == pytest.approx(most, rel=0.01)
    assert task.completed
    assert stage.command("HipPitch") == 0.9


def test_a_second_task_waits_for_the_joint(stage: Stage) -> None:
    first = stage.add(interpolation("HeadYaw", (1.0, 0.5)))
    second = stage.add(interpolation("HeadYaw", (1.0, -0.5)))
    other = stage.add(interpolation("HeadPitch", (0.5, 0.1)))
    stage.run(0.7)
    assert (first.running, second.running, other.over) == (True, False, True)
    stage.run(0.5)
    assert (first.over, second.running) == (True, True)
    stage.run(1.0)
    assert second.completed
    assert stage.command("HeadYaw") == -0.5


def test_a_target_waits_for_a_task(stage: Stage) -> None:
    stage.add(interpolation("HeadYaw", (1.0, 0.5)))
    stage.run(0.1)
    stage.motion.joints.set_target(joint("HeadYaw"), -0.2, 0.5)
    stage.run(0.85)
    assert stage.command("HeadYaw") > 0.45
    stage.run(2.0)
    assert stage.command("HeadYaw") == -0.2


def test_a_killed_task_lets_its_joint_come_to_rest(stage: Stage) -> None:
    task = stage.add(interpolation("HeadYaw", (2.0, 1.5)))
    stage.run(1.0)
    there = stage.command("HeadYaw")
    stage.motion.joints.kill([task])
    assert (task.over, task.completed) == (True, False)
    stage.motion.joints.kill([task])  # as two who stop the same may do
    stage.run(2.0)
    assert there < stage.command("HeadYaw") < there + 0.3
    rates = np.diff(stage.sent("HeadYaw")) / 0.012
    assert np.abs(np.diff(rates)).max() < 0.15


def test_a_joint_without_stiffness_is_left_alone_and_starts_where_it_lies(stage: Stage) -> None:
    stage.motion.joints.stiffness[joint("HeadYaw")] = 0.0
    stage.run(0.1)
    stage.motion.joints.set_target(joint("HeadYaw"), 1.0, 1.0)
    before = stage.robot.now
    stage.robot.show("Device/SubDeviceList/HeadYaw/Position/Sensor/Value", 0.7)  # a person turns it
    stage.run(0.5)
    assert angle_key("HeadYaw") not in stage.robot.written(before)
    stage.motion.joints.stiffness[joint("HeadYaw")] = 1.0
    stage.run(1.0)
    # It is held where it was, and does not go on to where it could not go.
    assert stage.sent("HeadYaw")[-1] == pytest.approx(0.7)


def test_with_everything_off_and_nothing_to_do_nothing_is_written(stage: Stage) -> None:
    stage.motion.awake = True
    stage.run(0.1)
    before = stage.robot.now
    stage.run(1.0)
    assert stage.robot.written(before) == set()


@pytest.mark.parametrize(
    ("reflex", "written"),
    [
        ("diagnosis", {angle_key(name) for name in CONFIG.joint_names}),
        ("smart_stiffness", {hardness_key(name) for name in CONFIG.joint_names}),
        ("fall_manager", {angle_key(name) for name in LEG}),
        ("push_recovery", {angle_key(name) for name in LEG} | WHEELS),
    ],
)
def test_each_reflex_writes_what_it_says(stage: Stage, reflex: str, written: set[str]) -> None:
    stage.motion.awake = True
    setattr(stage.motion.reflexes, reflex, True)
    stage.run(0.1)
    before = stage.robot.now
    stage.run(0.5)
    assert stage.robot.written(before) == written
    stage.motion.awake = False
    stage.run(0.1)
    before = stage.robot.now
    stage.run(0.5)
    assert stage.robot.written(before) == set()


@pytest.mark.parametrize("kind", ["self_collision", "external"])
def test_protection_writes_its_arm(stage: Stage, kind: str) -> None:
    stage.motion.awake = True
    getattr(stage.motion.reflexes, kind)["LArm"] = True
    stage.run(0.1)
    before = stage.robot.now
    stage.run(0.5)
    assert stage.robot.written(before) == {angle_key(name) for name in ARM}


def test_it_fights_another_user_of_the_dcm_until_it_is_switched_off(stage: Stage) -> None:
    """Both order the same joint: what the DCM sends jumps between the two, and is smooth with one of them alone."""
    stage.motion.awake = True
    stage.motion.reflexes.self_collision["LArm"] = True
    key, angle = angle_key("LShoulderPitch"), stage.command("LShoulderPitch")

    def other() -> None:
        if stage.robot.now % 12 == 0:
            date = stage.robot.now + 36
            value = angle + 0.3 * np.sin((stage.robot.now - begin) / 1000)
            stage.robot.order([key], "ClearAfter", [[(value, date)]])

    begin = stage.robot.now
    stage.run(2.0, other)
    fought = np.abs(np.diff(stage.sent("LShoulderPitch"))[-80:]).max()
    stage.motion.reflexes.self_collision["LArm"] = False
    stage.run(2.0, other)
    alone = np.abs(np.diff(stage.sent("LShoulderPitch"))[-80:]).max()
    assert fought > 0.05
    assert alone < 0.004  # 0.3 rad/s for 12 ms


def test_it_does_not_see_what_others_ordered(stage: Stage) -> None:
    """After orders of others a motion starts from ALMotion's own last command: with a jerk, as NAOqi warns."""
    key = angle_key("HeadYaw")
    stage.robot.order([key], "ClearAll", [[(1.0, stage.robot.now + 500)]])
    stage.run(1.0)
    assert stage.sent("HeadYaw")[-1] == 1.0
    stage.motion.joints.set_target(joint("HeadYaw"), 0.1, 0.1)
    stage.run(0.2)
    assert np.abs(np.diff(stage.sent("HeadYaw"))[-20:]).max() > 0.2


def test_smart_stiffness_lets_go_while_nothing_moves(stage: Stage) -> None:
    stage.motion.awake = stage.motion.reflexes.smart_stiffness = True
    stage.run(1.0)
    assert stage.robot.value(hardness_key("HipPitch")) == SETTINGS.smart_stiffness
    stage.motion.joints.set_target(joint("HeadYaw"), 1.0, 0.1)
    stage.run(0.3)
    assert stage.robot.value(hardness_key("HipPitch")) == 1.0


def test_motions_do_not_jump_when_the_clock_rolls_over() -> None:
    stage = Stage(clock=SPAN // 2 - 1000)
    stage.quiet()
    stage.stiffen()
    stage.add(interpolation("HeadYaw", (2.0, 1.0)))
    stage.run(2.2)
    assert stage.robot.time() < 0
    assert np.abs(np.diff(stage.sent("HeadYaw"))).max() < 0.012
    assert stage.sent("HeadYaw")[-1] == pytest.approx(1.0)


def test_a_writer_that_was_stopped_goes_on_where_it_was(stage: Stage) -> None:
    stage.add(interpolation("HeadYaw", (2.0, 1.0)))
    stage.run(1.0)
    stage.robot.now += 5000
    stage.run(1.5)
    # It lost 5 s; for one cycle it goes on by 0.1 s at most.
    assert np.abs(np.diff(stage.sent("HeadYaw"))).max() < 0.08
    assert stage.sent("HeadYaw")[-1] == pytest.approx(1.0)


def test_idle_joints_breathe_until_they_are_used(stage: Stage) -> None:
    stage.motion.idle.alive = True
    anchor = stage.command("LShoulderPitch")
    stage.run(6.0)
    swing = np.ptp(stage.sent("LShoulderPitch")[-420:])
    assert 0.5 < swing / (2 * SETTINGS.breathing.amplitude) <= 1.01
    assert np.abs(np.diff(stage.sent("LShoulderPitch"))).max() < 0.002
    stage.motion.joints.set_target(joint("LShoulderPitch"), anchor - 0.5, 0.2)
    stage.run(6.0)
    last = np.array(stage.sent("LShoulderPitch")[-420:])
    assert last.mean() == pytest.approx(anchor - 0.5, abs=0.01)
    stage.motion.idle.alive = False
    stage.run(0.2)
    before = stage.robot.now
    stage.run(0.5)
    assert stage.robot.written(before) == set()


def test_an_idle_posture_brings_joints_back(stage: Stage) -> None:
    stage.motion.joints.set_target(joint("HeadYaw"), 0.5, 0.5)
    stage.run(1.0)
    stage.motion.idle.posture = {"Head"}
    stage.run(6.0)
    assert stage.sent("HeadYaw")[-1] == pytest.approx(
        CONFIG.posture("Stand")[joint("HeadYaw")], abs=1e-3
    )


def test_the_living_head_looks_around_and_no_farther_than_said(stage: Stage) -> None:
    stage.motion.idle.looking = True
    stage.run(20.0)
    yaw = np.array(stage.sent("HeadYaw"))
    assert np.ptp(yaw) > 0.2
    assert np.abs(yaw).max() <= SETTINGS.glance.yaw + 1e-6
    assert len({round(value, 4) for value in yaw[::400]}) > 3


def test_closing_releases_waiting_callers(stage: Stage) -> None:
    task = stage.add(interpolation("HeadYaw", (100.0, 1.0)))
    results: list[bool] = []
    time = VirtualTime()
    time.start(lambda: results.append(task.wait(time.clock())), "client")
    stage.run(0.2)
    time.sleep(1.0)
    assert not results, "it waits"
    stage.motion.close()
    time.sleep(0.1)
    assert results == [False]
    time.close()


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("Head: [HeadYaw, HeadPitch]", "Head: [HeadYaw]", "HeadPitch"),
        ("Head: [HeadYaw, HeadPitch]", "Head: [HeadYaw, HedPitch]", "HeadPitch"),
        ("rest: Crouch", "rest: Crouhc", "Crouch"),
        ("MaxVelXY: [0.1, 0.35, 0.55]", "MaxVelXY: [0.1, 0.65, 0.55]", "MaxVelXY"),
        ("HipPitch: 0.4", "HipPich: 0.4", "HipPitch"),
        ("lead_time: 0.040", "leed_time: 0.040", "leed_time"),
    ],
)
def test_wrong_settings_are_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = package_file("naoqi_services.yaml").read_text()
    assert old in text
    path = tmp_path / "naoqi_services.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=word):
        load_naoqi_services(CONFIG, path)
