"""Orders of programs: drive the base, follow tasks, change several things at once."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Pepper
from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import TickEvent
from pepper_driver.config import UnknownNameError
from pepper_driver.controller import (
    ChangesError,
    LookAtTask,
    PositionTask,
    RobotMismatchError,
    TargetError,
    TaskCountError,
    Tick,
    whole_body,
)
from pepper_driver.safety import RobotState
from support.examples import examples
from support.robots import make_pepper
from support.sessions import ROBOT, backend_of, in_thread, stepped_time

HALF = round(0.5 / ROBOT.cycle)
"""[ticks] for which the base follows one ``drive``."""
YAW, PITCH = ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("HeadPitch")


def requested(pepper: Pepper, ticks: int) -> list[list[float]]:
    """The twist of the base that is requested in each of so many ticks."""
    twists: list[list[float]] = []
    target = pepper.controller.base_velocity
    pepper.run(ticks * ROBOT.cycle, on_tick=lambda *_: twists.append(target.target.tolist()))
    return twists


# -- the base -------------------------------------------------------------------------------------------------------

TWIST, STOP = [0.2, -0.05, 0.3], [0.0, 0.0, 0.0]


def test_the_base_drives_for_half_a_second_and_stops() -> None:
    with make_pepper() as pepper:
        pepper.drive(*TWIST)
        assert requested(pepper, 60) == HALF * [TWIST] + (60 - HALF) * [STOP]
        pepper.run(2.0)
        assert np.abs(backend_of(pepper).commands[-1].wheel_speed).max() < 0.01
        speeds = [np.abs(c.wheel_speed).max() for c in backend_of(pepper).commands]
        assert max(speeds) > 1.0, "it has rolled"


def test_who_says_so_again_drives_on() -> None:
    with make_pepper() as pepper:
        for _ in range(4):
            pepper.drive(*TWIST)
            assert requested(pepper, 30) == 30 * [TWIST]
        assert requested(pepper, 30) == (HALF - 30) * [TWIST] + (60 - HALF) * [STOP]
        pepper.drive(*TWIST)
        pepper.drive(0.0, 0.1, 0.0)
        assert requested(pepper, 50) == HALF * [[0.0, 0.1, 0.0]] + (50 - HALF) * [STOP]


def test_held_it_drives_until_the_next_command() -> None:
    with make_pepper() as pepper:
        pepper.drive(*TWIST, hold=True)
        assert requested(pepper, 500) == 500 * [TWIST]
        pepper.drive(0.0, 0.0, 0.0)
        assert requested(pepper, 60) == 60 * [STOP]
        pepper.drive(*TWIST, hold=True)
        pepper.drive(*TWIST)
        assert requested(pepper, 60) == HALF * [TWIST] + (60 - HALF) * [STOP]


@pytest.mark.parametrize(
    "twist", [(np.nan, 0, 0), (0, np.inf, 0), (0, 0, -np.inf), ("a", 0, 0), (None, 0, 0)]
)
def test_twists_that_are_none_are_refused_and_change_nothing(twist: Any) -> None:
    with make_pepper() as pepper:
        pepper.drive(*TWIST)
        for hold in (True, False):
            with pytest.raises(TargetError, match="drive takes"):
                pepper.drive(*twist, hold=hold)
        assert requested(pepper, 60) == HALF * [TWIST] + (60 - HALF) * [STOP]


class Skipping(MockBackend):
    """Half of its samples never come."""

    def read(self) -> Measurement:
        measurement = super().read()
        return replace(measurement, time=2 * measurement.time)


def test_half_a_second_is_the_robots_whatever_ticks_are_missed() -> None:
    pepper = make_pepper()
    pepper.backend = Skipping()
    with pepper:
        pepper.drive(*TWIST)
        assert requested(pepper, 30) == (HALF // 2) * [TWIST] + (30 - HALF // 2) * [STOP]


def test_the_base_of_a_program_that_hangs_stops() -> None:
    with stepped_time() as time, make_pepper(real_time=True) as pepper:
        time.wait_for_sleeper()
        pepper.drive(*TWIST)
        time.advance(0.4)
        assert pepper.controller.base_velocity.target.tolist() == TWIST
        time.advance(0.15)
        assert pepper.controller.base_velocity.target.tolist() == STOP


# -- tasks ----------------------------------------------------------------------------------------------------------


def reach() -> PositionTask:
    """A task that is built without a robot."""
    task = PositionTask("l_gripper", root="base_link")
    task.target = [0.3, 0.25, 0.9]
    return task


def gripper(pepper: Pepper) -> Any:
    return pepper.link_pose("l_gripper", of="commanded")[:3, 3]


def test_a_task_may_be_added_before_the_start_and_is_kept_for_the_next() -> None:
    pepper, task = make_pepper(), reach()
    pepper.add(task)
    pepper.add(task)
    for goal in ([0.3, 0.25, 0.9], [0.35, 0.1, 1.0]):
        task.target = goal
        with pepper:
            assert pepper.controller.tasks.count(task) == 1
            assert np.linalg.norm(gripper(pepper) - goal) > 0.1
            pepper.run(4.0)
            assert task.reached(0.02)
            np.testing.assert_allclose(gripper(pepper), goal, atol=0.02)
    pepper.remove(task)
    pepper.remove(task)
    with pepper:
        assert task not in pepper.controller.tasks


def test_a_motion_that_was_given_before_the_start_begins_with_it() -> None:
    pepper, task = make_pepper(), reach()
    goal = task.target
    task.move_to(goal, 1.0)
    pepper.add(task)
    with pepper:
        pepper.run(0.5)
        assert np.linalg.norm(gripper(pepper) - goal) > 0.05
        pepper.run(1.0)
        assert task.reached(0.02)


def test_a_task_may_come_and_go_while_the_robot_moves() -> None:
    pepper, task = make_pepper(), reach()
    with pepper:
        pepper.run(0.1)
        rest = gripper(pepper)
        pepper.add(task)
        pepper.run(3.0)
        assert task.reached(0.02)
        pepper.remove(task)
        pepper.run(4.0)
        np.testing.assert_allclose(gripper(pepper), rest, atol=0.02)
    with pepper:
        assert task not in pepper.controller.tasks


def test_a_task_that_was_added_inside_is_kept_and_constraints_are_too() -> None:
    pepper, task = make_pepper(), LookAtTask("Head")
    with pepper:
        pepper.add(task)
        own = pepper.controller.constraints
        pepper.run(0.1)
    coupling = own[0]
    pepper.add(coupling)
    with pepper:
        assert task in pepper.controller.tasks
        assert coupling in pepper.controller.constraints
    pepper.remove(coupling)
    with pepper:
        assert coupling not in pepper.controller.constraints


@pytest.mark.parametrize("active", [False, True])
def test_what_cannot_be_added_is_refused_at_once(active: bool) -> None:
    other = replace(ROBOT, links=ROBOT.links[::-1])
    pepper = make_pepper()
    if active:
        pepper.start()
    for nothing in (None, "l_gripper", PositionTask, object()):
        with pytest.raises(TypeError, match="a task or a constraint"):
            pepper.add(nothing)  # type: ignore[arg-type]
    with pytest.raises(RobotMismatchError, match="l_gripper"):
        pepper.add(PositionTask("l_gripper", robot=other))
    with pytest.raises(UnknownNameError):
        PositionTask("gripper")
    pepper.stop()
    with pepper:
        assert len(pepper.controller.tasks) == 2, "nothing of it is there"


def test_one_task_too_many_is_refused_and_not_kept() -> None:
    pepper = make_pepper()
    with pepper:
        while len(pepper.controller.tasks) < whole_body.MAX_TASKS:
            pepper.add(reach())
        with pytest.raises(TaskCountError):
            pepper.add(reach())
        with pytest.raises(TaskCountError), pepper.changes():
            pepper.add(reach())
        pepper.run(0.1)
    with pepper:
        assert len(pepper.controller.tasks) == whole_body.MAX_TASKS


def test_a_callback_that_adds_a_task_in_every_tick_is_refused_at_last(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pepper = make_pepper()

    @pepper.on_tick()
    def add(_: TickEvent) -> None:
        pepper.add(reach())

    with pepper:
        pepper.run(2.0)
        assert len(pepper.controller.tasks) == whole_body.MAX_TASKS
        assert pepper.state is RobotState.ACTIVE
    (statistics,) = pepper.callback_statistics
    assert statistics.failures == statistics.calls - (whole_body.MAX_TASKS - 2)
    assert "keep one task and set its target" in caplog.text


# -- together -------------------------------------------------------------------------------------------------------


def seen_in_ticks(pepper: Pepper, seen: list[tuple[float, ...]], *tasks: PositionTask) -> Any:
    def note(tick: Tick, _: object) -> None:
        arbiter = pepper.controller.posture
        seen.append(
            (
                float(arbiter.target[YAW]),
                float(arbiter.target[PITCH]),
                float(pepper.controller.base_velocity.target[0]),
                *(float(task.target[0]) for task in tasks),
            )
        )

    return note


def test_a_group_takes_effect_between_the_same_two_ticks() -> None:
    """Another thread changes five things at once, again and again, while the robot ticks as fast as it can."""
    first, second = reach(), PositionTask("r_gripper", root="base_link")
    second.target = [0.3, -0.25, 0.9]
    seen: list[tuple[float, ...]] = []
    stop = threading.Event()

    def change() -> None:
        number = 0
        while not stop.is_set():
            number = (number + 1) % 100
            value = 1e-3 * number
            with pepper.changes():
                pepper.set_posture({"HeadYaw": value})
                pepper.drive(value, 0.0, 0.0, hold=True)
                first.target = [value, 0.25, 0.9]
                pepper.set_posture({"HeadPitch": value})
                second.target = [value, -0.25, 0.9]

    with stepped_time() as time, make_pepper(real_time=True) as pepper, time.flowing():
        pepper.add(first)
        pepper.add(second)
        with pepper.changes():
            pepper.set_posture({"HeadYaw": 0.0, "HeadPitch": 0.0})
            first.target, second.target = [0.0, 0.25, 0.9], [0.0, -0.25, 0.9]
        changing = threading.Thread(target=change, daemon=True)
        changing.start()
        limited = pepper.run(  # a busy machine takes longer
            60.0,
            on_tick=seen_in_ticks(pepper, seen, first, second),
            until=lambda: len({values[0] for values in seen}) > 20,
        )
        stop.set()
        changing.join()
    assert limited
    assert all(len(set(values)) == 1 for values in seen)


def test_postures_of_one_group_add_up() -> None:
    with make_pepper() as pepper:
        with pepper.changes():
            pepper.set_posture({"HeadYaw": 0.3})
            pepper.set_posture({"HeadPitch": -0.2}, stiffness=20.0)
            pepper.set_posture({"HeadYaw": 0.4}, duration=1.0)
            assert pepper.target["HeadYaw"] != 0.4, "not yet"
        assert pepper.target["HeadYaw"] == 0.4
        assert pepper.target["HeadPitch"] == -0.2
        assert pepper.controller.posture.stiffness != 20.0
        pepper.step()
        assert pepper.controller.posture.stiffness == 20.0
        assert pepper.controller.posture.has_reference


def test_of_a_group_that_fails_nothing_is_made() -> None:
    task = reach()
    target = task.target
    pepper = make_pepper()

    def change() -> None:
        with pepper.changes():
            pepper.set_posture({"HeadYaw": 0.3})
            pepper.drive(*TWIST)
            pepper.add(task)
            task.target = [1.0, 0.0, 0.0]
            raise KeyError("the program's own")

    with pepper:
        before = pepper.target
        with pytest.raises(KeyError):
            change()
        assert requested(pepper, 3) == 3 * [STOP]
        np.testing.assert_array_equal(pepper.target, before)
        assert task not in pepper.controller.tasks
    with pepper:
        assert task not in pepper.controller.tasks
    task.target = target


@pytest.mark.parametrize("real_time", [False, True])
def test_the_robot_cannot_be_run_inside_a_group(real_time: bool) -> None:
    with stepped_time() as time, make_pepper(real_time=real_time) as pepper, time.flowing():
        for wait in (lambda: pepper.run(0.1), pepper.step, lambda: pepper.play("wave")):
            with pytest.raises(ChangesError, match="end the block first"), pepper.changes():
                wait()
        pepper.run(0.12)
        assert pepper.state is RobotState.ACTIVE


@examples(20)
@given(st.lists(st.tuples(st.sampled_from("abcd"), st.booleans(), st.booleans()), max_size=20))
def test_tasks_are_those_that_were_added_and_not_removed(
    story: list[tuple[str, bool, bool]],
) -> None:
    """In any order, before the start, while it ticks, in groups, over several starts."""
    tasks = {name: reach() for name in "abcd"}
    requested: list[PositionTask] = []
    pepper = make_pepper()
    for name, adds, restarts in story:
        task = tasks[name]
        if restarts:
            if pepper.state is RobotState.ACTIVE:
                pepper.stop()
            else:
                pepper.start()
        with pepper.changes():
            (pepper.add if adds else pepper.remove)(task)
        requested = [other for other in requested if other is not task] + adds * [task]
        if pepper.state is RobotState.ACTIVE:
            pepper.step()
            assert list(pepper.controller.tasks[2:]) == requested
    pepper.stop()
    with pepper:
        assert list(pepper.controller.tasks[2:]) == requested


def test_threads_that_make_changes_without_end_do_not_keep_ticks_waiting() -> None:
    """Ticks without a pause let them go first, but not again and again."""
    pepper = make_pepper()
    with pepper:
        stop = threading.Event()

        def linger() -> None:
            stop.wait(1e-4)

        def change() -> None:
            while not stop.is_set():
                pepper._changes.make(linger)

        threads = [threading.Thread(target=change, daemon=True) for _ in range(3)]
        for thread in threads:
            thread.start()
        run = in_thread(lambda: pepper.run(0.6))
        try:
            run.result()
        finally:
            stop.set()
            for thread in threads:
                thread.join()
