"""A hand that is moved without a plan: its force is that of a spring, it lets go by itself, and it tips no robot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pepper_driver.backends import CapabilityError, Command, CommandError, make_backend
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.mujoco_.pushes import HAND_ACCELERATION, HAND_SPEED
from pepper_driver.backends.simulated import HAND_TIMEOUT, Hand
from pepper_driver.config import UnknownNameError
from support.examples import examples

CYCLE = 0.012  # [s]


def stand(uri: str = "mujoco") -> MujocoBackend:
    backend = make_backend(uri)
    assert isinstance(backend, MujocoBackend)
    backend.open()
    backend.activate()
    return backend


@pytest.fixture
def backend() -> Iterator[MujocoBackend]:
    backend = stand()
    yield backend
    backend.close()


def run(backend: MujocoBackend, seconds: float, hand: Hand | None = None, goal: Any = None) -> None:
    """Stand still for a time, with a hand that is moved in every tick."""
    command = backend._written
    hold = Command(position=command.position, stiffness=command.stiffness, wheel_speed=np.zeros(3))
    for _ in range(round(seconds / CYCLE)):
        if hand is not None:
            hand.move(goal)
        backend.exchange(hold)


def test_its_place_is_known_before_the_first_step(backend: MujocoBackend) -> None:
    place = backend.truth.link_pose("LForeArm") @ [0.1, 0.0, 0.0, 1.0]
    hand = backend.take_hand("LForeArm", [0.1, 0.0, 0.0])
    assert hand.point == pytest.approx(place[:3], abs=1e-6)
    assert hand.position == pytest.approx(hand.point)


def test_its_force_is_that_of_its_spring(backend: MujocoBackend) -> None:
    hand = backend.take_hand("torso", [0.1, 0.0, 0.2], stiffness=1000.0)
    run(backend, CYCLE)
    assert np.linalg.norm(hand.force) < 0.5, "nothing yet"
    goal = hand.point + np.array([0.02, 0.0, 0.0])
    run(backend, 2.0, hand, goal)
    assert hand.position == pytest.approx(goal, abs=1e-4)
    assert hand.force == pytest.approx(1000.0 * (goal - hand.point), abs=0.2)
    assert np.linalg.norm(hand.force) > 5.0
    (contact,) = backend.truth.contacts
    assert (contact.kind, contact.link) == ("hand", "torso")
    assert contact.force == pytest.approx(hand.force, abs=0.2)
    assert contact.point == pytest.approx(hand.point, abs=1e-3)


def test_it_slips_at_its_largest_force(backend: MujocoBackend) -> None:
    hand = backend.take_hand("torso", stiffness=1000.0, max_force=12.0)
    run(backend, CYCLE)
    goal = hand.point + np.array([0.3, 0.0, 0.0])
    run(backend, 1.0, hand, goal)
    assert np.linalg.norm(hand.force) == pytest.approx(12.0)
    hand.move(goal, max_force=6.0)
    run(backend, 0.1)
    assert np.linalg.norm(hand.force) == pytest.approx(6.0)


def test_a_jump_of_the_goal_is_no_blow(backend: MujocoBackend) -> None:
    """It goes as a hand can, whatever is asked of it."""
    hand = backend.take_hand("torso", max_force=5.0)
    run(backend, CYCLE)
    before, last = hand.position, np.zeros(3)
    for _ in range(60):
        run(backend, CYCLE, hand, before + np.array([5.0, -3.0, 1.0]))
        velocity = (hand.position - before) / CYCLE
        assert np.linalg.norm(velocity) <= HAND_SPEED * (1 + 1e-9)
        assert np.linalg.norm(velocity - last) <= HAND_ACCELERATION * CYCLE * (1 + 1e-6) + 1e-9
        before, last = hand.position, velocity
    assert np.linalg.norm(last) == pytest.approx(HAND_SPEED, rel=0.01)


@pytest.mark.parametrize("given", [None, 0.2, 1.5])
def test_a_hand_that_no_one_moves_lets_go(backend: MujocoBackend, given: float | None) -> None:
    timeout = HAND_TIMEOUT if given is None else given
    hand = backend.take_hand("torso", **({} if given is None else {"timeout": given}))
    run(backend, 1.0, hand, hand.point + np.array([0.05, 0.0, 0.0]))
    assert hand.holds, "as long as it is moved"
    run(backend, timeout - 2 * CYCLE)
    assert hand.holds
    assert np.linalg.norm(hand.force) > 5.0
    run(backend, 0.2)
    assert not hand.holds
    assert not hand.force.any()
    run(backend, CYCLE)
    assert backend.truth.contacts == ()


def test_released_it_fades_at_once_and_another_may_take_the_link(backend: MujocoBackend) -> None:
    hand = backend.take_hand("torso")
    run(backend, 1.0, hand, hand.point + np.array([0.02, 0.0, 0.0]))
    before = np.linalg.norm(hand.force)
    with pytest.raises(CommandError, match="already holds torso"):
        backend.take_hand("torso")
    backend.take_hand("Head")  # another link
    hand.release()
    run(backend, 0.05)
    assert 0.0 < np.linalg.norm(hand.force) < 0.8 * before
    run(backend, 0.1)
    assert not hand.holds
    backend.take_hand("torso")


def test_what_is_wrong_is_refused_and_nothing_holds(backend: MujocoBackend) -> None:
    with pytest.raises(UnknownNameError, match="Haed"):
        backend.take_hand("Haed")
    with pytest.raises(CommandError, match="stiffness"):
        backend.take_hand("Head", stiffness=1e6)
    for timeout in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(CommandError, match="timeout"):
            backend.take_hand("Head", timeout=timeout)
    with pytest.raises(CommandError, match="point"):
        backend.take_hand("Head", [np.nan, 0.0, 0.0])
    hand = backend.take_hand("Head")
    for goal in ([np.inf, 0.0, 0.0], [0.0, 0.0], "there"):
        with pytest.raises(CommandError, match="position"):
            hand.move(goal)
    with pytest.raises(CommandError, match="max_force"):
        hand.move([0.0, 0.0, 1.0], max_force=0.0)


def test_no_other_robot_has_such_hands() -> None:
    with make_backend("mock") as backend, pytest.raises(CapabilityError, match="simulated"):
        backend.take_hand("Head")


def test_a_restored_robot_is_held_by_no_one(backend: MujocoBackend) -> None:
    """And goes on as without a hand, bit for bit."""
    run(backend, 0.3)
    before = backend.snapshot()
    run(backend, 0.5)
    free = backend.truth.position
    backend.restore(before)
    hand = backend.take_hand("LForeArm")
    run(backend, 0.3, hand, hand.point + np.array([0.0, 0.2, 0.0]))
    held = backend.snapshot()
    backend.restore(held)
    assert not hand.holds
    backend.restore(before)
    run(backend, 0.5)
    assert np.array_equal(backend.truth.position, free)


DIRECTIONS = st.tuples(*(st.floats(-1.0, 1.0) for _ in range(3)))


@examples(15)
@example(link="Head", ways=[(1.0, 0.0, 0.0)] * 2 + [(0.0, 0.0, 0.0)], reach=3.0, stiffness=500.0)
@given(
    link=st.sampled_from(["Head", "torso", "LForeArm", "r_wrist", "Hip", "l_gripper"]),
    ways=st.lists(DIRECTIONS, min_size=1, max_size=5),
    reach=st.sampled_from([0.05, 0.3, 3.0]),
    stiffness=st.floats(500.0, 1500.0),
)
def test_however_it_is_shaken_the_robot_stays_on_its_wheels(
    link: str, ways: list[tuple[float, float, float]], reach: float, stiffness: float
) -> None:
    """Beyond a degree or two, a wheel is off the floor."""
    backend = stand()
    try:
        hand = backend.take_hand(link, stiffness=stiffness, max_force=200.0)
        run(backend, CYCLE)
        for way in ways:
            for _ in range(25):
                run(backend, CYCLE, hand, hand.point + reach * np.array(way))
                assert np.degrees(np.abs(backend.truth.tilt)).max() < 2.0
    finally:
        backend.close()
