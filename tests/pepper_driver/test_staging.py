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
from pepper_driver.config.scenario_contacts import (
    JointPush,
    PushPoint,
    RandomForces,
    RandomPushes,
)
from pepper_driver.config.scenario_contacts import Push as ForcePush
from pepper_driver.config.scenario_motion import BaseMotion, Holds, Script, Setpoints, Step
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.observer import Observation
from pepper_driver.pushing import Bounds, PushTooStrongError, plan_push
from pepper_driver.robot import Pepper
from pepper_driver.scenes import plan_scenes
from pepper_driver.staging import Stage, scenario_uri
from pepper_driver.timeline import Leg, random_leg

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
        stiffness = pepper.backend.plant.stiffness[ROBOT.joint_index(push.joint)]
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
                pepper.backend.plant,
                joint=joint,
                link=pushes.points[joint][0].link,
                point=np.array(pushes.points[joint][0].xyz),
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


def setpoints(**changes: Any) -> Scenario:
    """Set-points of the arms that the demonstration pushes, with pushes of what each can take."""
    motion, (pushes,) = DEMO.motion, DEMO.contacts
    assert isinstance(motion, Setpoints)
    assert isinstance(pushes, RandomPushes)
    contact = replace(pushes, degrees=(0.5, 1.5), **changes)
    return replace(DEMO, settle=1.0, motion=replace(motion, count=2), contacts=(contact,))


def test_the_base_moves_as_the_scenario_says_and_stops_at_its_end() -> None:
    pepper = make_pepper("rolling")
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    base = BaseMotion(linear=0.2, angular=0.5, share=1.0)
    driving = replace(motion, base=base, count=2, period=1.2)
    stage = Stage(pepper, replace(DEMO, motion=driving, contacts=()), 3)
    targets, wheels = [], []

    def on_tick(tick: Tick, _: Observation | None) -> None:
        targets.append(pepper.controller.base_velocity.target.copy())
        wheels.append(np.abs(tick.measurement.wheel_speed).max())

    with pepper:
        stage.perform(on_tick=on_tick)
        np.testing.assert_array_equal(pepper.controller.base_velocity.target, np.zeros(3))
    first, second = np.array(targets[:100]), np.array(targets[100:])
    for part in (first, second):
        assert part.any()
        np.testing.assert_array_equal(part, np.broadcast_to(part[0], part.shape))
    assert (first[0] != second[0]).any()
    assert max(wheels) > 0.3


def test_pushes_rise_as_fast_as_the_scenario_says(monkeypatch: pytest.MonkeyPatch) -> None:
    rises = []
    for rise in (None, (0.04, 0.05)):
        pepper = make_pepper()
        asked: list[dict[str, Any]] = []
        monkeypatch.setattr(pepper.backend, "push", lambda *_, asked=asked, **kw: asked.append(kw))
        stage = Stage(pepper, setpoints(rise=rise), 0)
        with pepper:
            stage.perform()
        rises.append([kw.get("rise", 0.0) for kw in asked])
    assert rises[0] == [0.0] * 4, "that of the backend"
    assert all(0.04 <= rise <= 0.05 for rise in rises[1])
    assert len(set(rises[1])) == 4


def test_forces_on_the_trunk_are_meant_for_no_joint() -> None:
    forces = RandomForces(
        kind="random_forces",
        times=(0.3, 1.0),
        newtons=(4.0, 12.0),
        duration=(0.3, 0.4),
        points=(PushPoint(link="torso", xyz=(0.0, 0.0, 0.2)),),
    )
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    scenario = replace(DEMO, motion=replace(motion, count=3, period=2.4), contacts=(forces,))
    pepper = make_pepper("rolling")
    stage = Stage(pepper, scenario, 2)
    seen = watch(pepper, stage)
    assert len(stage.pushes) == 6
    assert {push.joint for push in stage.pushes} == {None}
    assert {push.link for push in stage.pushes} == {"torso"}
    assert all(4.0 <= push.force <= 12.0 for push in stage.pushes)
    assert len({round(push.force, 6) for push in stage.pushes}) == 6
    legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
    time, torque = np.array(seen.time), np.degrees(np.abs(np.array(seen.torque)))
    degrees = torque[:, legs] / pepper.backend.plant.stiffness[legs]
    for push in stage.pushes:
        during = (time > push.onset) & (time < push.release)
        assert degrees[during].max() == pytest.approx(push.degrees, rel=0.1)


def test_a_goal_in_which_nothing_fits_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes near the limit, which only arms that hang leave room for."""
    redrawn = []

    def counted(*arguments: Any) -> Leg:
        redrawn.append(arguments)
        return random_leg(*arguments)

    monkeypatch.setattr("pepper_driver.touch_planning.random_leg", counted)
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    size = (0.7 * limit, 0.72 * limit)
    scenario = setpoints(joints=("LShoulderRoll",))
    motion, (contact,) = scenario.motion, scenario.contacts
    assert isinstance(motion, Setpoints)
    assert isinstance(contact, RandomPushes)
    tight = replace(
        scenario,
        motion=replace(motion, range=1.0, also_range=1.0, count=6),
        contacts=(replace(contact, degrees=size),),
    )
    for seed in range(4):
        rng = np.random.default_rng(seed)
        scenes = plan_scenes(tight, ROBOT, pepper.backend, rng)
        assert len(scenes) == 7
        assert [len(scene.touches) for scene in scenes] == [0, 2, 2, 2, 2, 2, 2]
        planned = [touch.planned for scene in scenes for touch in scene.touches]
        assert all(push.load <= tight.largest_load for push in planned)
    assert redrawn


def test_pushes_on_the_way_are_planned_for_where_the_joints_will_be() -> None:
    pepper = make_pepper()
    scenario = setpoints(on_the_way=True, rise=(0.1, 0.1), joints=("LShoulderRoll",))
    scenario = replace(scenario, settle=3.0)
    rng = np.random.default_rng(1)
    scenes = plan_scenes(scenario, ROBOT, pepper.backend, rng)
    _, first, second = scenes
    np.testing.assert_array_equal(second.origin, first.posture)
    np.testing.assert_allclose(second.expected(0.0), second.origin)
    np.testing.assert_allclose(second.expected(60.0), second.posture)
    pepper = make_pepper()
    stage = Stage(pepper, scenario, 1)
    position: list[FloatArray] = []
    with pepper:
        stage.perform(on_tick=lambda *_: position.append(pepper.backend.truth.position))
    for ticks in (30, 60, 120):
        wanted, there = second.expected(ticks * ROBOT.cycle), position[664 + ticks]
        np.testing.assert_allclose(there[3:], wanted[3:], atol=0.12)
    moving = second.touches[0]
    posture, planned = second.expected(moving.delay + 0.1), moving.planned
    way = np.abs(posture - second.posture).max()
    assert way > 0.2, "else this test says nothing"
    model = RobotModel(ROBOT)
    force = model.link_pose(planned.link, posture)[:3, :3] @ planned.force
    torques = model.point_jacobian(planned.link, planned.point, posture).T @ force
    np.testing.assert_allclose(planned.torques, torques, atol=1e-9)


def test_joints_are_pushed_evenly_if_that_is_wanted() -> None:
    """The shoulder roll can take little of these sizes, the shoulder pitch more."""
    pepper = make_pepper()
    counts = []
    for evenly in (False, True):
        scenario = setpoints(evenly=evenly)
        motion, (contact,) = scenario.motion, scenario.contacts
        assert isinstance(motion, Setpoints)
        assert isinstance(contact, RandomPushes)
        limit = limit_degrees(pepper, "LShoulderRoll")
        low, high = 0.6 * limit, 3.0 * limit
        contact = replace(contact, degrees=(low, high))
        place = contact.points["LShoulderRoll"]
        points = {**contact.points, "LShoulderPitch": place}
        contact = replace(contact, points=points, joints=("LShoulderRoll", "LShoulderPitch"))
        motion = replace(motion, joints=("LElbowRoll",), also_move=(), range=0.1, count=60)
        scenario = replace(scenario, motion=motion, contacts=(contact,))
        scenes = plan_scenes(scenario, ROBOT, pepper.backend, np.random.default_rng(0))
        planned = [touch.planned for scene in scenes for touch in scene.touches]
        counts.append(sum(push.joint == "LShoulderRoll" for push in planned) / len(planned))
    assert counts[0] < 0.4
    assert 0.42 < counts[1] < 0.58


def test_two_pushes_at_once_stay_within_what_the_robot_can_take() -> None:
    pepper = make_pepper("rolling")
    scenario = setpoints()
    (contact,) = scenario.contacts
    assert isinstance(contact, RandomPushes)
    both = tuple(
        replace(contact, joints=(joint,), jitter=0.0) for joint in ("LShoulderRoll", "RElbowRoll")
    )
    motion = scenario.motion
    assert isinstance(motion, Setpoints)
    pairs = replace(scenario, motion=replace(motion, count=15), contacts=both, largest_tipping=0.6)
    scenes = plan_scenes(pairs, ROBOT, pepper.backend, np.random.default_rng(0))
    together = []
    for scene in scenes[1:]:
        assert len(scene.touches) == 4
        for one, other in (scene.touches[:2], scene.touches[2:]):
            assert {one.planned.joint, other.planned.joint} == {"LShoulderRoll", "RElbowRoll"}
            together.append(one.planned.tipping + other.planned.tipping)
    assert max(together) <= 0.6
    assert max(together) > 0.5, "else nothing was refused"


def test_the_robot_moves_freely_first_if_that_is_wanted() -> None:
    pepper = make_pepper()
    scenario = setpoints(after=2 * 7.968)
    motion = scenario.motion
    assert isinstance(motion, Setpoints)
    scenario = replace(scenario, motion=replace(motion, count=4))
    scenes = plan_scenes(scenario, ROBOT, pepper.backend, np.random.default_rng(0))
    assert [len(scene.touches) for scene in scenes] == [0, 0, 0, 2, 2]
