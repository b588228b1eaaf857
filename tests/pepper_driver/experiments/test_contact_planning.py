"""Contacts are planned for where the robot will be; what it could not take is refused before it moves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import ConfigError, Experiment, load_experiment
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import PushPoint, RandomForces, RandomPushes
from pepper_driver.config.steps import Setpoints
from pepper_driver.controller import RobotModel
from pepper_driver.experiments import plan as plan_module
from pepper_driver.experiments.plan import Plan, plan_experiment
from pepper_driver.experiments.push_planning import PushLimits, PushTooStrongError, plan_push
from pepper_driver.experiments.segments import Segment, goal_step
from pepper_driver.robot import Pepper
from support.experiments import CYCLE, ROBOT, listen, make_experiment, with_played
from support.pushes import PUSHED_ARMS, limit_degrees, make_pepper

REACH = load_experiment("reach_and_push", ROBOT)
INDEX = ROBOT.joint_index("LShoulderRoll")
PERIOD = 7.968


def pushes_of(experiment: Experiment) -> RandomPushes:
    (contact,) = experiment.contacts
    assert isinstance(contact, RandomPushes)
    return contact


def goals_of(experiment: Experiment) -> Setpoints:
    step = experiment.random_step
    assert step is not None
    assert isinstance(step.goals, Setpoints)
    return step.goals


def plan(pepper: Pepper, experiment: Experiment, seed: int | list[int] = 0) -> Plan:
    return plan_experiment(experiment, ROBOT, pepper.backend, seed=seed)


def still(*contacts: dict[str, Any], length: float = 3.0) -> Experiment:
    """A robot that stays in Stand and is touched."""
    return make_experiment({"posture": "Stand", "hold": length}, contacts=list(contacts))


def push_of(degrees: float, **changes: Any) -> dict[str, Any]:
    """Equivalent degrees on the left shoulder roll."""
    return {
        "kind": "joint_push",
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "xyz": [0.16, 0.015, 0.0],
        "degrees": degrees,
        "direction": 1,
        "start": 0.6,
        "duration": 1.2,
    } | changes


def force_of(*force: float, **changes: Any) -> dict[str, Any]:
    """A force on the left upper arm [N]."""
    return {
        "kind": "push",
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "xyz": [0.16, 0.0, 0.0],
        "force": list(force),
        "start": 0.5,
        "duration": 0.5,
    } | changes


# -- what the robot can take ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.9, 1.15])
def test_a_push_near_saturation_must_be_marked(ratio: float) -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    soft = push_of(0.3 * limit, start=2.0, duration=0.5)
    with pytest.raises(ConfigError, match=r"^mine: key 'contacts\.1': .*would load"):
        plan(pepper, still(soft, push_of(ratio * limit)))
    planned = plan(pepper, still(soft, push_of(ratio * limit, saturating=True)))
    loads = [contact.planned.load for contact in planned.at_begin]
    assert loads[0] < 0.5
    assert loads[1] >= ratio


def test_a_force_that_is_too_large_is_refused_before_anything_moves() -> None:
    pepper = make_pepper()
    with pytest.raises(ConfigError, match=r"key 'contacts\.0': 300\.0 N on LBicep"):
        plan(pepper, still(force_of(0.0, 300.0, 0.0)))
    with pytest.raises(ConfigError, match=r"key 'contacts\.0'.*does not turn RShoulderRoll"):
        plan(pepper, still(force_of(0.0, 5.0, 0.0, joint="RShoulderRoll")))


def test_on_wheels_nothing_tips_the_robot() -> None:
    place = {"joint": "HipPitch", "link": "torso", "xyz": [0.0, 0.0, 0.0], "saturating": True}
    strong, light = force_of(60.0, 0.0, 0.0, **place), force_of(10.0, 0.0, 0.0, **place)
    with pytest.raises(ConfigError, match=r"key 'contacts\.0'.*tips the robot over"):
        plan(make_pepper("rolling"), still(strong))
    plan(make_pepper(), still(strong))
    plan(make_pepper("rolling"), still(light))


def test_only_a_robot_that_can_be_pushed_is(monkeypatch: pytest.MonkeyPatch) -> None:
    pepper = make_pepper()
    info = replace(pepper.backend.info, capabilities=frozenset())
    monkeypatch.setattr(type(pepper.backend), "info", property(lambda _: info))
    with pytest.raises(ConfigError, match="key 'contacts': only simulated robots"):
        plan(pepper, REACH)
    plan(pepper, replace(REACH, contacts=()))


def test_two_hands_are_not_on_one_link_at_a_time() -> None:
    pepper = make_pepper()
    first, concurrent = push_of(1.0), push_of(1.0, start=1.9)
    plan(pepper, still(first, concurrent, length=6.0))
    plan(pepper, still(first, force_of(0.0, 3.0, 0.0, link="LForeArm", xyz=[0.1, 0.0, 0.0])))
    with pytest.raises(
        ConfigError, match=r"key 'contacts\.1': another hand is on LBicep between 1"
    ):
        plan(pepper, still(first, push_of(1.0, start=1.7), length=6.0))


def test_the_shipped_experiments_fit_the_shipped_plant() -> None:
    for name in ("demo", "reach_and_push"):
        experiment = load_experiment(name, ROBOT)
        planned = plan(Pepper("mujoco", observer=None), experiment)
        assert sum(len(segment.contacts) for segment in planned.segments) >= 3


# -- when and where ---------------------------------------------------------------------------------------------------


def test_a_push_is_planned_for_the_posture_at_its_time() -> None:
    """The same force on the forearm turns the shoulder more with the elbow straight than bent."""
    pepper = make_pepper()
    force = force_of(0.0, 6.0, 0.0, link="LForeArm", xyz=[0.1, 0.0, 0.0], start=1.0)
    steps = [
        {"name": "a", "posture": "Stand", "joints": {"LShoulderRoll": 0.6}, "hold": 6.0},
        {"name": "b", "joints": {"LShoulderPitch": 1.0, "LElbowRoll": -0.9}, "hold": 6.0},
    ]
    contacts = [force, force | {"start": 7.0}, force | {"start": 3.0, "step": "b"}]
    planned = plan(pepper, make_experiment(*steps, contacts=contacts))
    first, second = planned.segments
    assert [contact.delay for contact in planned.at_begin] == [1.0, 7.0]
    assert [contact.delay for contact in second.contacts] == [3.0]
    model = RobotModel(ROBOT)
    torques = []
    for segment in (first, second):
        jacobian = model.point_jacobian("LForeArm", np.array([0.1, 0.0, 0.0]), segment.posture)
        torques.append(6.0 * jacobian[1, INDEX])
    found = [contact.planned.torque for contact in (*planned.at_begin, *second.contacts)]
    assert found == pytest.approx([torques[0], torques[1], torques[1]])
    assert torques[0] != pytest.approx(torques[1], rel=0.02)
    shoulder = [contact.moving for contact in (*planned.at_begin, *second.contacts)]
    assert shoulder == [False, False, False], "the shoulder roll moves in none of them"


def test_a_contact_says_whether_its_joint_moves_then() -> None:
    """The spring of the posture task takes six time constants."""
    pepper = make_pepper()
    rest = 6.0 / np.sqrt(5.0)
    steps = [
        {"posture": "Stand", "hold": 3.0},
        {"name": "out", "joints": {"LShoulderRoll": 0.6}, "hold": 6.0},
    ]
    contacts = [push_of(1.0, step="out", start=start, duration=0.1) for start in (0.3, rest + 0.1)]
    _, out = plan(pepper, make_experiment(*steps, contacts=contacts)).segments
    assert [contact.moving for contact in out.contacts] == [True, False]


LATER = push_of(1.0, start=9.0)
TIMES: list[tuple[list[Any], dict[str, Any], str]] = [
    (
        [{"posture": "Stand", "hold": 3.0}],
        push_of(1.0, start=2.0),
        "ends after the experiment, which is over at 3 s",
    ),
    (
        [{"name": "a", "posture": "Stand", "hold": 3.0}, {"hold": 3.0}],
        push_of(1.0, start=2.0, step="a"),
        "ends at 3.2 s, after step 'a', which is over at 3 s",
    ),
    ([{"name": "a", "posture": "Stand", "hold": 30.0}], LATER | {"step": "b"}, "unknown step 'b'"),
    (
        [{"name": "a", "posture": "Stand", "hold": 30.0}, {"name": "a", "hold": 30.0}],
        LATER | {"step": "a"},
        "several steps are called 'a'; give them different names",
    ),
    (
        [{"posture": "Stand", "hold": 3.0}, listen(timeout=3.0), {"hold": 6.0}],
        LATER,
        "the motion at 9 s is unknown",
    ),
    (
        [
            {"posture": "Stand", "hold": 3.0},
            {"repeat": {"times": 2, "steps": [{"hold": 3.0}], "until": {}}},
            {"hold": 6.0},
        ],
        LATER,
        "the motion at 9 s is unknown",
    ),
    ([{"joints": {"HeadYaw": 0.2}, "hold": 30.0}], LATER, "says where"),
]


@pytest.mark.parametrize(("steps", "contact", "reason"), TIMES)
def test_a_time_that_is_unknown_is_refused(
    steps: list[Any], contact: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ConfigError, match=r"^mine: key 'contacts\.0") as caught:
        plan(make_pepper(), make_experiment(*steps, contacts=[contact]))
    assert reason in str(caught.value)


def test_a_contact_after_the_end_of_a_shorter_run_is_refused() -> None:
    pepper = make_pepper()
    other = make_experiment({"posture": "Stand", "hold": 1.0}, contacts=[push_of(1.0, start=20.0)])
    experiment = replace(PUSHED_ARMS, contacts=other.contacts)
    plan(pepper, experiment)
    with pytest.raises(ConfigError, match=r"key 'contacts\.0': ends after the experiment"):
        plan(pepper, experiment.with_goals(count=2))


# -- in blocks --------------------------------------------------------------------------------------------------------


def test_a_contact_in_a_loop_comes_in_each_round() -> None:
    """Planned once, for where the step leads when it is first played."""
    out = {"name": "out", "joints": {"LShoulderRoll": 0.6}, "hold": 3.0}
    loop = {"repeat": {"times": 4, "steps": [out, {"joints": {"LShoulderRoll": 0.2}, "hold": 3.0}]}}
    experiment = make_experiment(
        {"posture": "Stand", "hold": 3.0}, loop, contacts=[push_of(1.0, step="out")]
    )
    planned = plan(make_pepper(), experiment)
    rounds = planned.rounds["steps.1.repeat.steps.0"]
    assert [len(played) for played in rounds] == [1], "all rounds alike"
    assert [contact.delay for contact in rounds[0][0].contacts] == [0.6]


def goals_step(**changes: Any) -> dict[str, Any]:
    values = {"joints": ["HeadYaw"], "range": 0.5, "settle": 1.2, "count": 2, "period": 2.4}
    return {"name": "goals", "setpoints": values | changes}


def test_a_contact_in_random_goals_comes_in_each_round_too() -> None:
    loop = {"repeat": {"times": 3, "steps": [goals_step()]}}
    contact = push_of(1.0, step="goals", start=2.4)
    planned = plan(make_pepper(), make_experiment(loop, contacts=[contact]))
    rounds = planned.rounds["steps.0.repeat.steps.0"]
    assert len(rounds) == 3
    for segments in rounds:
        assert [len(segment.contacts) for segment in segments] == [1, 0, 0]
        assert segments[0].contacts[0].delay == 2.4
    long = push_of(1.0, step="goals", start=5.5)
    with pytest.raises(ConfigError, match="after step 'goals', which is over at 6 s"):
        plan(make_pepper(), make_experiment(loop, contacts=[long]))


def test_random_contacts_in_a_loop_are_drawn_again() -> None:
    random = {
        "kind": "random_pushes",
        "times": [0.6],
        "joints": ["LShoulderRoll"],
        "degrees": [0.5, 1.5],
        "duration": [0.3, 0.5],
        "points": {"LShoulderRoll": {"link": "LBicep", "xyz": [0.16, 0.015, 0.0]}},
    }
    loop = {"repeat": {"times": 3, "steps": [goals_step()]}}
    planned = plan(make_pepper(), make_experiment(loop, contacts=[random]))
    degrees = [
        [contact.planned.degrees for contact in segment.contacts]
        for segments in planned.rounds["steps.0.repeat.steps.0"]
        for segment in segments
    ]
    assert [len(drawn) for drawn in degrees] == [0, 1, 1] * 3
    assert len({size for drawn in degrees for size in drawn}) == 6


def branch(*first: dict[str, Any], name: str | None = "choice") -> dict[str, Any]:
    cases = [{"on": {"limb": "left_arm"}, "steps": list(first)}]
    step: dict[str, Any] = {"branch": {"timeout": 3.0, "cases": cases}}
    return step if name is None else step | {"name": name}


def test_a_contact_may_be_what_a_branch_waits_for() -> None:
    contact = push_of(1.0, step="choice")
    for name in ("choice", None):
        step = branch(name=name)
        contact["step"] = name or "branch"
        experiment = make_experiment({"posture": "Stand", "hold": 1.2}, step, contacts=[contact])
        _, wait = plan(make_pepper(), experiment).segments
        assert [c.delay for c in wait.contacts] == [0.6]


def test_a_contact_in_a_case_is_planned_for_its_steps() -> None:
    out = {"name": "out", "joints": {"LShoulderRoll": 0.9}, "hold": 3.0}
    contact = push_of(1.0, step="out")
    stand = {"posture": "Stand", "hold": 1.2}
    planned = plan(make_pepper(), make_experiment(stand, branch(out), contacts=[contact]))
    (segment,) = planned.rounds["steps.1.branch.cases.0.steps.0"][0]
    assert segment.posture[INDEX] == 0.9
    assert len(segment.contacts) == 1


def test_after_a_branch_the_posture_may_be_unknown() -> None:
    """One case moves the arm, and otherwise it stays: where a push would find it is unknown."""
    out = {"joints": {"LShoulderRoll": 0.9}, "hold": 3.0}
    stand, rest = {"posture": "Stand", "hold": 1.2}, {"name": "rest", "hold": 3.0}
    contact = push_of(1.0, step="rest")
    with pytest.raises(ConfigError, match=r"key 'contacts\.0'.*says where LShoulderRoll is"):
        plan(make_pepper(), make_experiment(stand, branch(out), rest, contacts=[contact]))
    for step in (rest | {"joints": {"LShoulderRoll": 0.2}}, rest | {"posture": "Stand"}):
        planned = plan(make_pepper(), make_experiment(stand, branch(out), step, contacts=[contact]))
        assert len(planned.segments[-1].contacts) == 1
    back = {"joints": {"LShoulderRoll": float(ROBOT.posture("Stand")[INDEX])}, "hold": 1.2}
    same = make_experiment(stand, branch(out, back), rest, contacts=[contact])
    assert plan(make_pepper(), same).segments[-1].contacts[0].moving, "it may have just come back"


def test_random_contacts_are_those_of_steps_and_of_no_reaction() -> None:
    step = goals_step(count=1)
    random = {
        "kind": "random_forces",
        "times": [0.6],
        "newtons": [2.0, 4.0],
        "duration": [0.3, 0.5],
        "points": {"link": "torso", "xyz": [0.0, 0.0, 0.2]},
    }
    experiment = make_experiment(step, contacts=[random], reactions=[{"play": "p"}])
    experiment = with_played(experiment, p=make_experiment(goals_step(count=1)))
    planned = plan(make_pepper(), experiment)
    found = {key: [len(s.contacts) for s in rounds[0]] for key, rounds in planned.rounds.items()}
    assert found == {"steps.0": [0, 1], "reactions.0.play.0": [0, 0]}


# -- random contacts --------------------------------------------------------------------------------------------------


def test_random_pushes_that_never_fit_are_refused_with_the_reason() -> None:
    pepper = make_pepper()
    size = 1.5 * limit_degrees(pepper, "LShoulderRoll")
    pushes = replace(pushes_of(PUSHED_ARMS), degrees=(size, size), joints=("LShoulderRoll",))
    with pytest.raises(
        ConfigError, match=r"key 'contacts\.0': no push of its sizes fits.*would load"
    ):
        plan(pepper, replace(PUSHED_ARMS, contacts=(pushes,)))
    plan(pepper, replace(PUSHED_ARMS, contacts=(replace(pushes, saturating=True),)))


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
                bounds=PushLimits(load=PUSHED_ARMS.max_load, tipping=PUSHED_ARMS.max_tipping),
            )
        except PushTooStrongError:
            continue
        return joint, direction, degrees


def test_random_numbers_are_drawn_in_this_order() -> None:
    """Goals, then for each push its time, its length, and joint, size, direction until one fits: as ever."""
    pepper = make_pepper()
    _, *segments = plan(pepper, PUSHED_ARMS.with_goals(count=3), [7, 1]).segments
    goals, pushes = goals_of(PUSHED_ARMS), pushes_of(PUSHED_ARMS)
    rng = np.random.default_rng([7, 1])
    middle, half = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2
    posture = ROBOT.posture("Stand")
    assert len(segments) == 3
    for segment in segments:
        for names, ratio in (
            (goals.joints, goals.range),
            (goals.secondary_joints, goals.secondary_range),
        ):
            for name in names:
                i = ROBOT.joint_index(name)
                posture[i] = middle[i] + ratio * half[i] * rng.uniform(-1.0, 1.0)
        np.testing.assert_allclose(segment.posture, posture, atol=1e-12)
        for time, contact in zip(pushes.times, segment.contacts, strict=True):
            assert contact.delay == pytest.approx(time + rng.uniform(-0.5, 0.5) * pushes.jitter)
            assert contact.duration == pytest.approx(rng.uniform(*pushes.duration))
            joint, direction, degrees = first_that_fits(pushes, posture, rng, pepper)
            planned = contact.planned
            assert (planned.joint, np.sign(planned.torque)) == (joint, direction)
            assert planned.degrees == pytest.approx(degrees)


def setpoints(**changes: Any) -> Experiment:
    """Set-points of the arms that the demonstration pushes, with pushes of what each can take."""
    contact = replace(pushes_of(PUSHED_ARMS), degrees=(0.5, 1.5), **changes)
    return replace(PUSHED_ARMS.with_goals(settle=1.0, count=2), contacts=(contact,))


def test_a_goal_in_which_nothing_fits_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes near the limit, which only arms that hang leave room for."""
    drawn = []

    def counted(*arguments: Any) -> Any:
        drawn.append(arguments)
        return goal_step(*arguments)

    monkeypatch.setattr(plan_module, "goal_step", counted)
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    tight = setpoints(joints=("LShoulderRoll",)).with_goals(range=1.0, secondary_range=1.0, count=6)
    pushes = replace(pushes_of(tight), degrees=(0.7 * limit, 0.72 * limit))
    tight = replace(tight, contacts=(pushes,))
    for seed in range(4):
        segments = plan(pepper, tight, seed).segments
        assert [len(segment.contacts) for segment in segments] == [0, 2, 2, 2, 2, 2, 2]
        planned = [contact.planned for segment in segments for contact in segment.contacts]
        assert all(push.load <= tight.max_load for push in planned)
    assert len(drawn) > 4 * 6, "else nothing was drawn again"


def test_pushes_in_motion_are_planned_for_where_the_joints_will_be() -> None:
    pepper = make_pepper()
    experiment = setpoints(in_motion=True, rise=(0.1, 0.1), joints=("LShoulderRoll",))
    experiment = experiment.with_goals(settle=3.0)
    planned = plan(pepper, experiment, 1)
    _, first, second = planned.segments
    np.testing.assert_array_equal(second.origin, first.posture)
    np.testing.assert_allclose(second.expected(0.0), second.origin)
    np.testing.assert_allclose(second.expected(60.0), second.posture)
    contact = second.contacts[0]
    posture, push = second.expected(contact.delay + 0.1), contact.planned
    way = np.abs(posture - second.posture).max()
    assert way > 0.2, "else this test says nothing"
    model = RobotModel(ROBOT)
    force = model.link_pose(push.link, posture)[:3, :3] @ push.force
    torques = model.point_jacobian(push.link, push.point, posture).T @ force
    np.testing.assert_allclose(push.torques, torques, atol=1e-9)
    position: list[FloatArray] = []
    with pepper:
        pepper.play(planned, on_tick=lambda *_: position.append(pepper.backend.truth.position))
    begin = round(3.0 / CYCLE) + round(PERIOD / CYCLE)
    for ticks in (30, 60, 120):
        predicted, there = second.expected(ticks * CYCLE), position[begin + ticks]
        np.testing.assert_allclose(there[3:], predicted[3:], atol=0.12)


def contacts_in(segments: list[Segment]) -> list[list[Any]]:
    return [segment.contacts for segment in segments]


def test_joints_are_pushed_evenly_if_that_is_requested() -> None:
    """The shoulder roll can take little of these sizes, the shoulder pitch more."""
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    ratios = []
    for balanced in (False, True):
        experiment = setpoints(balanced=balanced)
        contact = pushes_of(experiment)
        points = {**contact.points, "LShoulderPitch": contact.points["LShoulderRoll"]}
        contact = replace(
            contact,
            degrees=(0.6 * limit, 3.0 * limit),
            points=points,
            joints=("LShoulderRoll", "LShoulderPitch"),
        )
        experiment = replace(experiment, contacts=(contact,)).with_goals(
            joints=("LElbowRoll",), secondary_joints=(), range=0.1, count=60
        )
        planned = [c.planned for cs in contacts_in(plan(pepper, experiment).segments) for c in cs]
        ratios.append(sum(push.joint == "LShoulderRoll" for push in planned) / len(planned))
    assert ratios[0] < 0.4
    assert 0.42 < ratios[1] < 0.58


def test_two_pushes_at_once_stay_within_what_the_robot_can_take() -> None:
    pepper = make_pepper("rolling")
    experiment = setpoints()
    both = tuple(
        replace(pushes_of(experiment), joints=(joint,), jitter=0.0)
        for joint in ("LShoulderRoll", "RElbowRoll")
    )
    pairs = replace(experiment.with_goals(count=15), contacts=both, max_tipping=0.6)
    together = []
    for contacts in contacts_in(plan(pepper, pairs).segments)[1:]:
        assert len(contacts) == 4
        contacts.sort(key=lambda contact: contact.delay)
        for one, other in (contacts[:2], contacts[2:]):
            assert {one.planned.joint, other.planned.joint} == {"LShoulderRoll", "RElbowRoll"}
            together.append(one.planned.tipping + other.planned.tipping)
    assert max(together) <= 0.6
    assert max(together) > 0.5, "else nothing was refused"


def test_the_robot_moves_freely_first_if_that_is_requested() -> None:
    experiment = setpoints(after=2 * PERIOD).with_goals(count=4)
    segments = plan(make_pepper(), experiment).segments
    assert [len(segment.contacts) for segment in segments] == [0, 0, 0, 2, 2]


def test_forces_on_the_trunk_are_meant_for_no_joint() -> None:
    forces = RandomForces(
        kind="random_forces",
        times=(0.3, 1.0),
        newtons=(4.0, 12.0),
        duration=(0.3, 0.4),
        points=(PushPoint(link="torso", xyz=(0.0, 0.0, 0.2)),),
    )
    experiment = replace(PUSHED_ARMS.with_goals(count=3, period=2.4), contacts=(forces,))
    segments = plan(make_pepper("rolling"), experiment, 2).segments
    planned = [contact.planned for contacts in contacts_in(segments) for contact in contacts]
    assert len(planned) == 6
    assert {(push.joint, push.link) for push in planned} == {(None, "torso")}
    assert all(4.0 <= push.newtons <= 12.0 for push in planned)
    assert len({round(push.newtons, 6) for push in planned}) == 6


def test_one_seed_one_plan() -> None:
    def forces(seed: int) -> list[list[float]]:
        contacts = contacts_in(plan(make_pepper(), PUSHED_ARMS.with_goals(count=1), seed).segments)
        return [contact.planned.force.tolist() for cs in contacts for contact in cs]

    assert forces(4) == forces(4)
    assert forces(4) != forces(5)
