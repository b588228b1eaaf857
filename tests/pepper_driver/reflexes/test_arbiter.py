"""Parts of posture, base, stiffness and tasks: of user, experiment, reflexes of several priorities, and a pause."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BaseVelocityTask,
    LookAtTask,
    OrientationTask,
    PositionTask,
    Task,
    whole_body,
)
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.experiments.player import Player
from pepper_driver.loop import Loop
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes import (
    Arbiter,
    Assist,
    Comply,
    FollowHand,
    Hold,
    Ignore,
    Reflex,
    ReflexRequests,
    Retract,
    Soften,
    StopBase,
)
from pepper_driver.testing import standing_measurement
from support.examples import examples
from support.experiments import REACH, make_experiment
from support.reflexes import ARM, ROBOT, ROLL, Stage, touch

PUSH = {"LShoulderRoll": 2.0}
YAW = ROBOT.joint_index("HeadYaw")
RIGHT = [ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"]]


def turned(stage: Stage, joint: int, angle: float) -> FloatArray:
    """The user's posture, one joint further on."""
    target = stage.arbiter.target.copy()
    target[joint] += angle
    return target


def base_speed(stage: Stage) -> float:
    """Forwards [m/s]."""
    return float(stage.controller.model.v[0])


# -- posture --------------------------------------------------------------------------------------------------------


def test_the_user_has_the_posture_until_a_reflex_takes_it_and_gets_it_back() -> None:
    stage = Stage(Hold(release_delay=0.1))
    stage.arbiter.move_to(turned(stage, YAW, 0.6))
    stage.arbiter.posture_stiffness = 30.0
    stage.run(0.4)
    assert not stage.arbiter.holds
    assert stage.controller.posture.stiffness == 30.0
    stage.step(touch())
    stage.run(0.5)
    assert stage.arbiter.holds
    held = stage.controller.position[YAW]
    assert stage.controller.posture.stiffness != 30.0
    stage.arbiter.move_to(turned(stage, YAW, 0.3))  # of the user, meanwhile
    stage.arbiter.posture_stiffness = 40.0
    stage.run(0.5)
    assert stage.controller.position[YAW] == pytest.approx(held, abs=1e-3)
    stage.step(touch(phase="end"))
    stage.run(3.0)
    assert not stage.arbiter.holds
    assert stage.controller.position[YAW] == pytest.approx(stage.arbiter.target[YAW], abs=0.01)
    assert stage.controller.posture.stiffness == 40.0


def test_a_motion_of_the_posture_begins_again_after_it_was_held() -> None:
    stage = Stage(Hold(release_delay=0.1))
    stage.arbiter.move_to(turned(stage, YAW, 0.6), duration=2.0)
    stage.run(1.0)
    stage.step(touch())
    stage.run(1.0)
    held = stage.controller.position[YAW]
    stage.step(touch(phase="end"))
    stage.run(0.1 + 1.0)
    assert held < stage.controller.position[YAW] < 0.5, "it takes the whole time"
    stage.run(1.1)
    assert stage.controller.position[YAW] == pytest.approx(stage.arbiter.target[YAW], abs=2e-3)
    assert not stage.controller.posture.has_reference


class Posing(Reflex):
    """Holds the whole robot while it is touched, with a joint turned; claims nothing."""

    def __init__(self, angle: float, **arguments: Any) -> None:
        super().__init__(release_delay=0.0, **arguments)
        self.angle = angle

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        self.posture = requests.controller.position
        self.posture[YAW] += self.angle

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        requests.hold_posture(self.posture, 100.0)


@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_that_hold_the_posture_the_higher_priority_does(swapped: bool) -> None:
    reflexes: list[Reflex] = [
        Posing(0.2, priority=2, link="LBicep"),
        Posing(-0.2, priority=1),
    ]
    stage = Stage(*(reflexes[::-1] if swapped else reflexes))
    stage.step(touch())
    stage.step(touch(2, link="Head", joint="HeadYaw"))
    stage.run(2.0)
    assert stage.controller.position[YAW] == pytest.approx(0.2, abs=0.01)
    stage.step(touch(phase="end"))
    stage.run(2.0)
    assert stage.controller.position[YAW] == pytest.approx(-0.2, abs=0.01), "the next one"


def test_joints_of_one_reflex_move_while_another_has_the_rest() -> None:
    stage = Stage(Comply(priority=2), Retract(link="RForeArm", priority=1))
    stage.arbiter.move_to(turned(stage, YAW, 0.4), duration=1.0)
    torque = {**PUSH, "RShoulderRoll": -2.0}
    before = stage.step(
        touch(), touch(2, link="RForeArm", joint="RShoulderRoll", direction=-1), torque=torque
    )
    after = stage.run(1.1, torque=torque)[-1]
    assert after[ROLL] > before[ROLL] + 0.1
    assert after[RIGHT[1]] < before[RIGHT[1]] - 0.1
    assert after[YAW] == pytest.approx(0.4, abs=0.01), "the user's posture has the others"


def test_no_reflex_holds_without_a_contact_and_observations_are_not_needed_without_reflexes() -> (
    None
):
    stage = Stage()
    stage.arbiter.move_to(turned(stage, YAW, 0.4), duration=0.5)
    measurement = standing_measurement()
    for _ in range(60):
        assert stage.arbiter.step(None, measurement) == []
        stage.controller.step()
    assert stage.controller.position[YAW] == pytest.approx(stage.arbiter.target[YAW], abs=2e-3)
    assert (stage.arbiter.stiffness == 1.0).all()


def test_without_an_observation_reflexes_are_not_asked() -> None:
    stage = Stage(Hold())
    stage.step(touch())
    assert stage.arbiter.step(None, standing_measurement()) == []
    assert stage.reflexes[0].active


def test_reflexes_of_a_run_before_begin_again() -> None:
    stage = Stage(Hold())
    stage.step(touch())
    assert stage.reflexes[0].active
    Arbiter(stage.controller, ROBOT, stage.reflexes)
    assert not stage.reflexes[0].active


def test_a_reflex_that_was_one_of_two_has_its_name_for_itself_again() -> None:
    first, second = Hold(), Hold()
    Stage(first, second)
    assert (second.full_name, second.number) == ("hold 2", 2)
    Stage(second)
    assert (second.full_name, second.number) == ("hold", 1)


class Taking(Reflex):
    """Has the joints that a test gives it, as many of them as it gets."""

    def __init__(self, joints: list[str], **arguments: Any) -> None:
        super().__init__(release_delay=0.0, **arguments)
        self.claimed = joints

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        pass

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        for joint in self.claimed:
            requests.claim([joint])


def test_an_event_says_that_a_reflex_has_lost_one_joint() -> None:
    low = Taking(["HeadYaw", "HeadPitch"], name="low", priority=1)
    high = Taking(["HeadYaw"], name="high", priority=2, link="Head")
    stage = Stage(low, high)
    stage.step(touch(1))
    stage.step(touch(2, link="Head", joint="HeadYaw"))
    reported = [(event.reflex, event.phase, event.held_joints) for event in stage.events]
    assert reported == [
        ("low", "begin", ("HeadYaw", "HeadPitch")),
        ("high", "begin", ("HeadYaw",)),
        ("low", "update", ("HeadPitch",)),
    ]


# -- oscillation ----------------------------------------------------------------------------------------------------


def oscillating(*reflexes: Reflex) -> Stage:
    stage = Stage(*reflexes)
    stage.arbiter.attentive = True
    stage.run(4.0)
    assert stage.arbiter.attentive
    assert turns(stage.run(2.6), ROLL) > 1
    return stage


def turns(positions: FloatArray, joint: int) -> int:
    """Number of times that a joint changes its direction."""
    return int(np.count_nonzero(np.diff(np.sign(np.diff(positions[::5, joint])))))


def test_joints_that_a_reflex_has_do_not_oscillate() -> None:
    stage = oscillating(Taking(list(ROBOT.chains["left_arm"])))
    stage.step(touch())
    stage.run(2.0)  # to the posture, from where it was stopped
    positions = stage.run(2.6)
    assert turns(positions, ROLL) == 0
    assert turns(positions, RIGHT[1]) > 1
    stage.step(touch(phase="end"))
    stage.run(4.0)
    assert turns(stage.run(2.6), ROLL) > 1


def test_nothing_oscillates_while_the_whole_robot_is_held() -> None:
    stage = oscillating(Hold())
    stage.step(touch())
    stage.run(1.0)
    assert np.ptp(stage.run(1.0), axis=0).max() < 1e-3


# -- base -----------------------------------------------------------------------------------------------------------


def test_the_base_is_the_users_until_a_reflex_stops_it() -> None:
    stage = Stage(StopBase(release_delay=0.1))
    stage.arbiter.drive(np.array([0.2, 0.0, 0.0]))
    stage.run(2.0)
    assert base_speed(stage) == pytest.approx(0.2, abs=0.01)
    stage.step(touch())
    stage.run(1.5)
    assert base_speed(stage) == pytest.approx(0.0, abs=0.005)
    stage.step(touch(phase="end"))
    stage.run(3.0)
    assert base_speed(stage) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("ticks", [1, 2, 50])
@pytest.mark.parametrize("before", [0, 7])
def test_a_drive_lasts_as_many_ticks_as_its_time_has(ticks: int, before: int) -> None:
    stage = Stage()
    for _ in range(before):
        stage.step()
    stage.arbiter.drive(np.array([0.2, 0.0, 0.0]), ticks * ROBOT.cycle)
    driven = []
    for _ in range(ticks + 20):
        stage.step()
        driven.append(bool(stage.controller.base_velocity.target.any()))
    assert driven == [True] * ticks + [False] * 20


@pytest.mark.parametrize("reflex", [Hold, StopBase])
def test_the_time_of_a_drive_passes_while_a_reflex_has_the_base(reflex: type[Reflex]) -> None:
    stage = Stage(reflex(release_delay=0.0))
    stage.step(touch())
    stage.arbiter.drive(np.array([0.2, 0.0, 0.0]), 0.5)
    stage.run(1.0)
    stage.step(touch(phase="end"))
    stage.run(1.0)
    assert abs(base_speed(stage)) < 1e-3, "its command came a second ago"


def pulled(stage: Stage, force: float) -> dict[str, float]:
    """Torques of the left arm whose hand is pulled forwards [N]."""
    jacobian = stage.controller.model.point_jacobian(
        "l_wrist", np.zeros(3), stage.controller.position
    )
    torque = jacobian.T @ np.array([force, 0.0, 0.0])
    return {ROBOT.joint_names[k]: float(torque[k]) for k in ARM[:5]}


@pytest.mark.parametrize(("stop", "follows"), [(1, True), (9, False)])
def test_of_two_that_claim_the_base_the_higher_priority_gets_it(stop: int, follows: bool) -> None:
    """StopBase is above FollowHand when it is to be safe, and may be below."""
    stage = Stage(FollowHand(follow_with="base", priority=5), StopBase(priority=stop))
    torque = pulled(stage, 12.0)
    stage.step(touch(), torque=torque)
    stage.run(1.0, torque=torque)
    if follows:
        assert stage.controller.base_pose[0] > 0.02
    else:
        assert np.abs(stage.controller.base_pose).max() < 2e-3


# -- stiffness of the motors ----------------------------------------------------------------------------------------


def test_of_several_that_lower_the_stiffness_the_lowest_counts() -> None:
    for order in ([0, 1], [1, 0]):
        reflexes = [
            Soften(stiffness=0.6, release_delay=0.5),
            Soften(stiffness=0.3, release_delay=0.0),
        ]
        stage = Stage(*(reflexes[k] for k in order))
        stage.step(touch())
        assert (stage.arbiter.stiffness[ARM] == 0.3).all()
        assert (np.delete(stage.arbiter.stiffness, ARM) == 1.0).all()
        stage.step(touch(phase="end"))
        stage.step()
        assert (stage.arbiter.stiffness[ARM] == 0.6).all()
        stage.run(0.6)
        assert (stage.arbiter.stiffness == 1.0).all()


def test_a_limb_may_be_soft_and_held() -> None:
    stage = Stage(Hold(), Soften(stiffness=0.4))
    stage.step(touch())
    assert stage.arbiter.holds
    assert (stage.arbiter.stiffness[ARM] == 0.4).all()


# -- a pause --------------------------------------------------------------------------------------------------------


def test_a_pause_brings_all_to_rest_and_then_all_goes_on() -> None:
    stage = Stage()
    task = PositionTask("l_wrist", root="base_link")
    stage.step()
    stage.arbiter.add(task)
    stage.step()
    goal = task.target + np.array([0.05, 0.1, 0.1])
    task.move_to(goal, 3.0)
    stage.arbiter.move_to(turned(stage, YAW, 0.8))
    stage.arbiter.drive(np.array([0.2, 0.0, 0.0]))
    stage.run(1.0)
    stage.arbiter.paused = True
    trail = stage.run(3.0)
    assert stage.arbiter.holds
    assert np.abs(stage.controller.velocity).max() < 1e-4
    assert abs(base_speed(stage)) < 1e-3
    assert (np.diff(trail[:, YAW]) > -1e-9).all(), "it does not turn round"
    assert trail[-1, YAW] < 0.6
    stage.arbiter.paused = False
    stage.run(6.0)
    assert not stage.arbiter.holds
    assert task.reached(0.01)
    assert stage.controller.position[YAW] == pytest.approx(0.8, abs=0.05)
    assert base_speed(stage) == pytest.approx(0.2, abs=0.01)


def test_a_pause_goes_before_reflexes_which_go_on_to_watch() -> None:
    stage = Stage(comply := Comply(release_delay=0.1), Soften(stiffness=0.4, release_delay=0.1))
    stage.arbiter.paused = True
    before = stage.step(touch(), torque=PUSH)
    after = stage.run(1.0, torque=PUSH)[-1]
    np.testing.assert_allclose(after, before, atol=1e-4)
    assert comply.active
    assert (stage.arbiter.stiffness[ARM] == 0.4).all(), "softer is no motion"
    stage.arbiter.paused = False
    assert stage.run(0.5, torque=PUSH)[-1, ROLL] > before[ROLL] + 0.1


def test_a_pause_of_no_tick_changes_nothing() -> None:
    stage, other = Stage(), Stage()
    for one in (stage, other):
        one.arbiter.move_to(turned(one, YAW, 0.8), duration=2.0)
        one.run(0.5)
    stage.arbiter.paused = True
    stage.arbiter.paused = False
    np.testing.assert_array_equal(stage.run(0.5), other.run(0.5))


# -- steps ----------------------------------------------------------------------------------------------------------


class Playing:
    """Steps on the controller of a stage."""

    def __init__(self, stage: Stage, *steps: dict[str, Any]) -> None:
        tick = SimpleNamespace(measurement=standing_measurement())
        latest = SimpleNamespace(tick=tick, observation=None, events=())
        arbiter = stage.arbiter
        loop = SimpleNamespace(
            arbiter=arbiter, time=0.0, latest=latest, set_attentive=lambda value: None
        )
        self._stage = stage
        backend = MockBackend(ROBOT)
        plan = plan_experiment(make_experiment(*steps), ROBOT, backend)
        self.player = Player(plan, ROBOT, cast("Loop", loop), backend, lambda event: None)
        self.player.begin()
        self.over = False

    def run(self, seconds: float, *contacts: Contact) -> None:
        """Play on; contacts come in the first tick."""
        for _ in range(round(seconds / ROBOT.cycle)):
            self._stage.step(*contacts)
            contacts = ()
            self.over = self.over or self.player.advance()


def test_an_experiment_has_what_the_user_had_and_gives_it_back() -> None:
    stage = Stage()
    mine = LookAtTask("Head")
    stage.arbiter.add(mine)
    stage.arbiter.move_to(turned(stage, YAW, 0.2))
    stage.arbiter.posture_stiffness = 30.0
    stage.arbiter.drive(np.array([0.1, 0.0, 0.0]))
    stage.run(0.5)
    playing = Playing(
        stage, {"duration": 1.0, "position": REACH, "base_velocity": {"wz": 0.2}, "stiffness": 50.0}
    )
    playing.run(0.5)
    assert mine in stage.controller.tasks
    assert len(stage.controller.tasks) == 4
    assert stage.controller.posture.stiffness == 50.0
    assert stage.controller.base_velocity.target.tolist() == [0.0, 0.0, 0.2]
    playing.run(0.6)
    assert playing.over
    playing.player.end()
    stage.step()
    assert list(stage.controller.tasks[2:]) == [mine]
    assert stage.controller.posture.stiffness == 30.0
    assert stage.controller.base_velocity.target.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("holder", ["reflex", "pause"])
def test_steps_wait_while_a_reflex_or_a_pause_holds(holder: str) -> None:
    stage = Stage(Hold(release_delay=0.0))
    playing = Playing(stage, {"duration": 2.0, "joints": {"HeadYaw": 0.6}, "position": REACH})
    playing.run(1.0)
    begin = [touch()] if holder == "reflex" else []
    stage.arbiter.paused = holder == "pause"
    playing.run(3.0, *begin)
    assert not playing.over
    assert np.abs(stage.controller.velocity).max() < 1e-3
    assert len(stage.controller.tasks) == 3, "its task stands still"
    stage.arbiter.paused = False
    playing.run(1.5, *([touch(phase="end")] if begin else []))
    assert playing.over
    assert stage.controller.position[YAW] == pytest.approx(0.6, abs=0.02)


# -- tasks ----------------------------------------------------------------------------------------------------------


class Working(Reflex):
    """Has the controller follow tasks of its own, one or two in turn; notes which in this tick."""

    def __init__(self, number: int, **arguments: Any) -> None:
        super().__init__(name=f"working {number}", **arguments)
        self._tasks = [
            OrientationTask("Head", name=f"{number} a"),
            BaseVelocityTask(name=f"{number} b"),
        ]
        self.requested: set[Task] = set()
        self.ticks = 0

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        self.requested = set()
        super().step(observation, measurement, requests)

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        self.ticks += 1
        self.requested = set(self._tasks[: 1 + self.ticks % 2])
        for task in self.requested:
            requests.add_task(task)
            requests.add_task(task)


def names(tasks: Sequence[Task]) -> list[str]:
    return sorted(task.name for task in tasks)


ACTIONS = st.one_of(
    st.tuples(st.just("add"), st.integers(0, 3)),
    st.tuples(st.just("remove"), st.integers(0, 3)),
    st.tuples(st.just("pause"), st.booleans()),
    st.tuples(st.just("move"), st.floats(-0.5, 0.5)),
    st.tuples(st.just("drive"), st.floats(-0.2, 0.2)),
    st.tuples(st.just("play"), st.booleans()),
    st.tuples(
        st.just("contact"),
        st.tuples(
            st.sampled_from(["begin", "update", "end"]),
            st.integers(1, 3),
            st.sampled_from(["LBicep", "Head", "torso"]),
            st.sampled_from(["contact", "collision", "rebound"]),
        ),
    ),
)


@examples(60)
@given(st.lists(st.tuples(ACTIONS, st.integers(1, 4)), max_size=25))
def test_the_controllers_tasks_are_the_users_the_steps_and_those_of_active_reflexes(
    story: list[tuple[tuple[str, Any], int]],
) -> None:
    """After any sequence, in every tick, and no task twice."""
    reflexes = [
        Working(1, priority=9, link="LBicep", release_delay=0.03),
        Working(2, priority=5, kind="collision", release_delay=0.0),
        Working(3, priority=0, release_delay=0.05, max_duration=0.2),
    ]
    stage = Stage(
        *reflexes,
        Ignore(link="torso", priority=3),
        Hold(link="Head", priority=7, release_delay=0.03),
    )
    users = [PositionTask("l_wrist", name=f"user {k}") for k in range(4)]
    added: list[Task] = []
    player: Player | None = None
    for (kind, value), ticks in story:
        contacts: tuple[Contact, ...] = ()
        if kind == "add":
            stage.arbiter.add(users[value])
            added = [task for task in added if task is not users[value]] + [users[value]]
        elif kind == "remove":
            stage.arbiter.remove(users[value])
            added = [task for task in added if task is not users[value]]
        elif kind == "pause":
            stage.arbiter.paused = value
        elif kind == "move":
            target = stage.controller.position
            target[YAW] = value
            stage.arbiter.move_to(target)
        elif kind == "drive":
            stage.arbiter.drive(np.array([value, 0.0, 0.0]), 0.05)
        elif kind == "play" and value and player is None:
            player = Playing(stage, {"duration": 0.1, "position": REACH}).player
        elif kind == "play" and not value and player is not None:
            player.end()
            player = None
        elif kind == "contact":
            phase, number, link, sort = value
            contacts = (touch(number, phase, link=link, kind=sort),)
        for _ in range(ticks):
            stage.step(*contacts)
            contacts = ()
            if player is not None and player.advance():
                player.end()
                player = None
            goals = [] if player is None else [goal.task for goal in player._active]
            requested = [task for reflex in reflexes for task in reflex.requested]
            expected = [*stage.own_tasks, *added, *goals, *requested]
            assert names(stage.controller.tasks) == names(expected)
            assert {id(task) for task in stage.controller.tasks} == {id(task) for task in expected}
            for reflex in reflexes:
                assert reflex.active or not reflex.requested
    if player is not None:
        player.end()
    stage.arbiter.paused = False
    for number in (1, 2, 3):
        stage.step(touch(number, "end"))
    stage.run(0.3)
    assert set(stage.controller.tasks) == {*stage.own_tasks, *added}


def test_reflexes_act_however_many_tasks_the_user_has() -> None:
    stage = Stage(Comply())
    for _ in range(whole_body.MAX_TASKS - 2):
        stage.arbiter.add(LookAtTask("Head", weight=1e-6))
    before = stage.step(touch(), torque=PUSH)[ROLL]
    assert len(stage.controller.tasks) == whole_body.MAX_TASKS + 1
    assert stage.run(0.5, torque=PUSH)[-1, ROLL] > before + 0.05
    stage.step(touch(phase="end"))
    stage.run(1.0)
    assert len(stage.controller.tasks) == whole_body.MAX_TASKS


@examples(40)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["begin", "end"]),
            st.integers(1, 4),
            st.sampled_from(
                [("LBicep", "LShoulderRoll"), ("RForeArm", "RElbowRoll"), ("Head", "HeadYaw")]
            ),
        ),
        max_size=15,
    )
)
def test_no_joint_is_given_to_two_reflexes(story: list[tuple[Any, int, tuple[str, str]]]) -> None:
    reflexes: list[Reflex] = [
        Comply(priority=5, link="LBicep", release_delay=0.05),
        Retract(priority=4, release_delay=0.02),
        Assist(priority=3, link="RForeArm", release_delay=0.1),
        Hold(priority=2, link="Head", release_delay=0.0),
        FollowHand(priority=1, release_delay=0.05),
    ]
    given_to: list[dict[str, set[int]]] = []

    class Watching(ReflexRequests):
        def claim(self, joints: Any) -> bool:
            taken = super().claim(joints)
            if taken:
                given_to[-1][f"{len(given_to[-1])}"] = set(np.flatnonzero(joints).tolist())
            return taken

    stage = Stage(*reflexes)
    stage.arbiter._requests = Watching(stage.controller, ROBOT)
    for phase, number, (link, joint) in story:
        given_to.append({})
        stage.step(touch(number, phase, link=link, joint=joint), torque=PUSH)
        for _ in range(3):
            given_to.append({})
            stage.step(torque=PUSH)
    for tick in given_to:
        joints = [joint for taken in tick.values() for joint in taken]
        assert len(joints) == len(set(joints))
