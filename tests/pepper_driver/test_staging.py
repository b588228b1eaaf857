"""What is planned is what happens, and what the robot could not take is refused before it moves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pepper_driver.config import ConfigError, Scenario, load_scenario
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import JointPush, RandomPushes
from pepper_driver.config.scenario_contacts import Push as ForcePush
from pepper_driver.config.scenario_motion import Holds, Script, Setpoints, Step
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.observer import Observation
from pepper_driver.pushing import Bounds, PushTooStrongError, plan_push
from pepper_driver.robot import Pepper
from pepper_driver.staging import Stage, scenario_uri

from scenario_cases import ROBOT, limit_degrees, make_pepper  # isort: skip

DEMO = load_scenario("demo", ROBOT)
REACH = load_scenario("reach_and_push", ROBOT)
INDEX = ROBOT.joint_index("LShoulderRoll")


def still(*contacts: Any, length: float = 3.0) -> Scenario:
    """A robot that stays in Stand and is touched."""
    motion = Script(kind="script", steps=(Step(time=0.0, posture="Stand"),), length=length)
    return replace(REACH, motion=motion, contacts=contacts)


def push_of(degrees: float, **changes: Any) -> JointPush:
    arguments: dict[str, Any] = {
        "kind": "joint_push",
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "xyz": (0.16, 0.015, 0.0),
        "degrees": degrees,
        "direction": 1,
        "start": 0.6,
        "duration": 1.2,
    }
    return JointPush(**(arguments | changes))


class Witness:
    """Targets, torques and saturation of every tick of a performance."""

    def __init__(self, pepper: Pepper) -> None:
        self._pepper = pepper
        self.time: list[float] = []
        self.target: list[FloatArray] = []
        self.torque: list[FloatArray] = []
        self.saturated: list[Any] = []

    def __call__(self, tick: Tick, _: Observation | None) -> None:
        truth = self._pepper.backend.truth
        self.time.append(tick.measurement.time)
        self.target.append(self._pepper.target)
        self.torque.append(truth.contact_torque)
        self.saturated.append(truth.saturated)


def watch(pepper: Pepper, stage: Stage) -> Witness:
    witness = Witness(pepper)
    with pepper:
        stage.perform(on_tick=witness)
    return witness


def test_stated_contacts_happen_as_planned() -> None:
    pepper = make_pepper()
    scenario = replace(REACH, contacts=REACH.contacts[:2])
    stage = Stage(pepper, scenario, 0)
    assert stage.pushes == (), "nothing has begun"
    seen = watch(pepper, stage)
    time, torque = np.array(seen.time), np.array(seen.torque)
    begin = time[0] - ROBOT.cycle
    assert len(stage.pushes) == 2
    for push, contact in zip(stage.pushes, scenario.contacts, strict=True):
        assert not isinstance(contact, RandomPushes)
        assert push.onset - begin == pytest.approx(contact.start, abs=1e-6)
        assert push.release - push.onset == pytest.approx(contact.duration)
        felt = torque[:, ROBOT.joint_index(push.joint)]
        during = (time > push.onset + 0.15) & (time < push.release - 0.15)
        np.testing.assert_allclose(felt[during], push.direction * push.torque, rtol=0.01)
        stiffness = pepper.backend.truth.stiffness[ROBOT.joint_index(push.joint)]
        assert push.degrees == pytest.approx(np.degrees(push.torque / stiffness))
        assert not push.saturating
    first, second = stage.pushes
    assert first.force == pytest.approx(20.0)
    assert second.degrees == pytest.approx(2.8)
    assert (first.direction, second.direction) == (1, -1)
    assert (first.moving, second.moving) == (True, False)


def test_the_script_is_followed_to_the_tick() -> None:
    pepper = make_pepper()
    seen = watch(pepper, Stage(pepper, replace(REACH, contacts=()), 0))
    assert len(seen.time) == round(16.0 / ROBOT.cycle)
    target = np.array(seen.target)
    for name, expected in {
        "LShoulderRoll": (0.6, 0.6, ROBOT.posture("Stand")[INDEX]),
        "LElbowRoll": (ROBOT.posture("Stand")[ROBOT.joint_index("LElbowRoll")], -0.9, None),
    }.items():
        column = target[:, ROBOT.joint_index(name)]
        assert column[499] == pytest.approx(expected[0])
        assert column[500] == pytest.approx(expected[1])
        if expected[2] is not None:
            assert column[-1] == pytest.approx(expected[2])


def test_stiffness_changes_where_the_script_says() -> None:
    pepper = make_pepper()
    stage = Stage(pepper, replace(REACH, contacts=()), 0)
    seen: list[float] = []
    with pepper:
        stage.perform(on_tick=lambda *_: seen.append(pepper.controller.posture.stiffness))
    assert seen[400] == 5.0
    assert seen[600] == 3.0
    assert seen[-1] == 5.0


def test_holds_go_a_minimum_jerk_way_and_stay() -> None:
    motion = Holds(
        kind="holds", joints=("HeadYaw", "RElbowRoll"), range=0.6, move=1.2, hold=0.6, count=3
    )
    pepper = make_pepper()
    seen = watch(pepper, Stage(pepper, replace(REACH, motion=motion, contacts=()), 3))
    target = np.array(seen.target)[:, ROBOT.joint_index("HeadYaw")]
    start = ROBOT.posture("Stand")[ROBOT.joint_index("HeadYaw")]
    assert len(target) == 450
    for hold in range(3):
        goal = target[150 * hold + 100]
        np.testing.assert_array_equal(target[150 * hold + 99 : 150 * hold + 149], goal)
        s = np.arange(2, 101) / 100  # the first step is set before the first tick of the way
        way = start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        np.testing.assert_allclose(target[150 * hold : 150 * hold + 99], way, atol=1e-9)
        start = goal
    assert np.ptp(target) > 0.1


def test_progress_rises_to_one() -> None:
    pepper = make_pepper()
    told: list[float] = []
    stage = Stage(pepper, still(), 0)
    with pepper:
        stage.perform(on_progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(told) >= 4


@pytest.mark.parametrize("share", [0.9, 1.15])
def test_a_push_near_saturation_must_be_marked(share: float) -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    degrees = share * limit
    with pytest.raises(ConfigError, match=r"reach_and_push\.yaml: key 'contacts\.1'.*would load"):
        Stage(pepper, still(push_of(0.3 * limit, start=2.0, duration=0.5), push_of(degrees)), 0)
    stage = Stage(pepper, still(push_of(degrees, duration=0.4, saturating=True)), 0)
    seen = watch(pepper, stage)
    (push,) = stage.pushes
    assert push.saturating == (share > 1)
    time = np.array(seen.time)
    during = (time >= push.onset) & (time <= push.release)
    assert push.saturated == np.array(seen.saturated)[during, INDEX].any()
    assert push.saturated or share < 1


def test_a_soft_push_saturates_nothing() -> None:
    pepper = make_pepper()
    stage = Stage(pepper, still(push_of(0.3 * limit_degrees(pepper, "LShoulderRoll"))), 0)
    watch(pepper, stage)
    assert [(push.saturating, push.saturated) for push in stage.pushes] == [(False, False)]


def test_a_force_that_is_too_large_is_refused_before_anything_moves() -> None:
    pepper = make_pepper()
    force = ForcePush(
        kind="push",
        joint="LShoulderRoll",
        link="LBicep",
        xyz=(0.16, 0.0, 0.0),
        force=(0.0, 300.0, 0.0),
        start=0.5,
        duration=0.5,
    )
    with pytest.raises(ConfigError, match=r"key 'contacts\.0': 300\.0 N on LBicep"):
        Stage(pepper, still(force), 0)
    wrong = replace(force, force=(0.0, 5.0, 0.0), joint="RShoulderRoll")
    with pytest.raises(ConfigError, match=r"key 'contacts\.0'.*does not turn RShoulderRoll"):
        Stage(pepper, still(wrong), 0)


def test_random_pushes_that_never_fit_are_refused_with_the_reason() -> None:
    (pushes,) = DEMO.contacts
    assert isinstance(pushes, RandomPushes)
    pepper = make_pepper()
    size = 1.5 * limit_degrees(pepper, "LShoulderRoll")
    strong = replace(
        DEMO, contacts=(replace(pushes, degrees=(size, size), joints=("LShoulderRoll",)),)
    )
    with pytest.raises(
        ConfigError, match=r"key 'contacts\.0': no push of its sizes fits.*would load"
    ):
        Stage(pepper, strong, 0)
    marked = replace(strong.contacts[0], saturating=True)
    Stage(pepper, replace(strong, contacts=(marked,)), 0)


def test_a_contact_after_the_end_of_a_shorter_run_is_refused() -> None:
    pepper = make_pepper()
    push = push_of(0.3 * limit_degrees(pepper, "LShoulderRoll"), start=20.0)
    scenario = replace(DEMO, contacts=(push,))
    Stage(pepper, scenario, 0)
    with pytest.raises(ConfigError, match=r"key 'contacts\.0': ends after this run"):
        Stage(pepper, scenario, 0, count=2)


def test_a_push_is_planned_for_the_posture_at_its_time() -> None:
    """The same force on the forearm turns the shoulder more with the elbow straight than bent."""
    pepper = make_pepper()
    force = ForcePush(
        kind="push",
        joint="LShoulderRoll",
        link="LForeArm",
        xyz=(0.1, 0.0, 0.0),
        force=(0.0, 6.0, 0.0),
        start=1.0,
        duration=0.5,
    )
    late = replace(force, start=11.0)
    stage = Stage(pepper, replace(REACH, contacts=(force, late)), 0)
    watch(pepper, stage)
    model = RobotModel(ROBOT)
    posture = ROBOT.posture("Stand")
    expected = []
    for joints in (
        {"LShoulderRoll": 0.6, "RElbowRoll": 1.0},
        {"LShoulderPitch": 1.0, "LElbowRoll": -0.9},
    ):
        for name, angle in joints.items():
            posture[ROBOT.joint_index(name)] = angle
        jacobian = model.point_jacobian("LForeArm", np.array([0.1, 0.0, 0.0]), posture)
        expected.append(abs(6.0 * jacobian[1, INDEX]))
    assert [push.torque for push in stage.pushes] == pytest.approx(expected)
    assert expected[0] != pytest.approx(expected[1], rel=0.02)


def test_a_grab_reaches_the_backend_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    pepper = make_pepper()
    grabs: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
    monkeypatch.setattr(
        pepper.backend, "grab", lambda *args, **kw: grabs.append((args, kw)), raising=False
    )
    stage = Stage(pepper, REACH, 0)
    with pepper:
        stage.perform()
    (((link, pull, point), options),) = grabs
    assert link == "LForeArm"
    np.testing.assert_array_equal(pull, [0.0, 0.03, 0.0])
    np.testing.assert_array_equal(point, [0.1, 0.0, 0.0])
    assert options.pop("delay") == pytest.approx(3.0)
    assert options == {
        "stiffness": 600.0,
        "rise": 0.6,
        "hold": 1.0,
        "release": 0.2,
        "largest_force": 100.0,
        "frame": "world",
    }
    record = stage.pushes[-1]
    assert record.link == "LForeArm"
    assert record.force == pytest.approx(18.0)
    assert record.release - record.onset == pytest.approx(1.8)


def test_only_a_robot_that_can_be_pushed_is(monkeypatch: pytest.MonkeyPatch) -> None:
    pepper = make_pepper()
    info = replace(pepper.backend.info, capabilities=frozenset())
    monkeypatch.setattr(type(pepper.backend), "info", property(lambda _: info))
    with pytest.raises(ConfigError, match="key 'contacts': only a simulated robot"):
        Stage(pepper, REACH, 0)
    Stage(pepper, replace(REACH, contacts=()), 0)


def test_on_wheels_nothing_tips_the_robot() -> None:
    force = ForcePush(
        kind="push",
        joint="HipPitch",
        link="torso",
        xyz=(0.0, 0.0, 0.0),
        force=(60.0, 0.0, 0.0),
        start=0.5,
        duration=0.5,
        saturating=True,
    )
    with pytest.raises(ConfigError, match=r"key 'contacts\.0'.*tips the robot over"):
        Stage(make_pepper("rolling"), still(force), 0)
    Stage(make_pepper(), still(force), 0)
    Stage(make_pepper("rolling"), still(replace(force, force=(10.0, 0.0, 0.0))), 0)


def first_that_fits(
    pushes: RandomPushes, posture: FloatArray, rng: np.random.Generator, pepper: Pepper
) -> tuple[str, int, float]:
    """Joint, direction and size [deg] of the first push drawn that can be planned."""
    while True:
        joint = pushes.joints[rng.integers(len(pushes.joints))]
        degrees = float(np.exp(rng.uniform(*np.log(pushes.degrees))))
        direction = int(rng.choice([-1, 1]))
        try:
            plan_push(
                RobotModel(ROBOT),
                ROBOT,
                pepper.backend.truth,
                joint=joint,
                link=pushes.points[joint].link,
                point=np.array(pushes.points[joint].xyz),
                degrees=degrees,
                direction=direction,
                posture=posture,
                bounds=Bounds(load=DEMO.largest_load, tipping=DEMO.largest_tipping),
            )
        except PushTooStrongError:
            continue
        return joint, direction, degrees


def test_the_random_numbers_of_the_demonstration_are_drawn_in_this_order() -> None:
    """Goals, then for each push its time, its length, and joint, size, direction until one fits: as ever."""
    pepper = make_pepper()
    stage = Stage(pepper, DEMO, [7, 1], count=3)
    goals: list[FloatArray] = []
    with pepper:
        stage.perform(on_tick=lambda *_: goals.append(pepper.target))
    motion, (pushes,) = DEMO.motion, DEMO.contacts
    assert isinstance(motion, Setpoints)
    assert isinstance(pushes, RandomPushes)
    rng = np.random.default_rng([7, 1])
    middle, half = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2
    posture = ROBOT.posture("Stand")
    expected = []
    for goal in range(3):
        for names, share in ((motion.joints, motion.range), (motion.also_move, motion.also_range)):
            for name in names:
                i = ROBOT.joint_index(name)
                posture[i] = middle[i] + share * half[i] * rng.uniform(-1.0, 1.0)
        np.testing.assert_allclose(goals[664 * goal + 300], posture, atol=1e-12)
        for time in pushes.times:
            delay = time + rng.uniform(-0.5, 0.5) * pushes.jitter
            duration = rng.uniform(*pushes.duration)
            joint, direction, degrees = first_that_fits(pushes, posture, rng, pepper)
            expected.append((joint, direction, degrees, 664 * 0.012 * goal + delay, duration))
    first = stage.pushes[0].onset - expected[0][3]
    for push, (joint, direction, degrees, onset, duration) in zip(
        stage.pushes, expected, strict=True
    ):
        assert (push.joint, push.direction) == (joint, direction)
        assert push.degrees == pytest.approx(degrees)
        assert push.onset - first == pytest.approx(onset)
        assert push.release - push.onset == pytest.approx(duration)


def test_one_seed_one_plan() -> None:
    plans = []
    for seed in (4, 4, 5):
        pepper = make_pepper()
        stage = Stage(pepper, DEMO, seed, count=1)
        with pepper:
            stage.perform()
        plans.append(stage.pushes)
    assert plans[0] == plans[1]
    assert plans[0] != plans[2]


@pytest.mark.parametrize(
    ("uri", "plant", "world", "expected"),
    [
        ("mujoco", None, None, "mujoco"),
        ("mujoco", "nominal", None, "mujoco://?plant=nominal"),
        ("mujoco://?seed=3", "nominal", "empty", "mujoco://?seed=3&plant=nominal&world=empty"),
        ("mujoco://?plant=other", "nominal", None, "mujoco://?plant=other"),
        ("naoqi://10.0.0.1", "nominal", "empty", "naoqi://10.0.0.1"),
    ],
)
def test_a_uri_keeps_what_it_says_itself(
    uri: str, plant: str | None, world: str | None, expected: str
) -> None:
    assert scenario_uri(uri, replace(DEMO, plant=plant, world=world)) == expected


def test_the_shipped_scenarios_fit_the_shipped_plant() -> None:
    for name in ("demo", "reach_and_push"):
        Stage(Pepper("mujoco", observer=None), load_scenario(name, ROBOT), 0)


def test_a_file_of_ones_own_is_performed(tmp_path: Path) -> None:
    data = read_yaml(package_file("scenarios", "reach_and_push.yaml"))
    data["motion"]["length"], data["motion"]["steps"] = 2.0, data["motion"]["steps"][:1]
    data["contacts"] = data["contacts"][:1]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    pepper = make_pepper()
    stage = Stage(pepper, load_scenario(path, ROBOT), 0)
    watch(pepper, stage)
    assert len(stage.pushes) == 1
