"""The constraint on a robot whose hand is sent through it."""

import pytest
from ceiling import Ceiling

from pepper_driver import Pepper
from pepper_driver.config import UnknownNameError
from pepper_driver.controller import LimitError, PositionTask

HEIGHT = 0.95


def highest(pepper: Pepper) -> float:
    """Return the largest commanded height of the left wrist on its motion to 1.15 m."""
    hand = PositionTask("l_wrist", root="base_link")
    hand.target = [0.25, 0.2, 1.15]
    heights: list[float] = []
    pepper.add(hand)
    pepper.run(
        3.0,
        on_tick=lambda *_: heights.append(float(pepper.link_pose("l_wrist", of="commanded")[2, 3])),
    )
    return max(heights)


def test_the_hand_stays_below_the_ceiling() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        pepper.add(Ceiling("l_wrist", HEIGHT))
        assert HEIGHT - 0.02 < highest(pepper) < HEIGHT + 0.001
        assert pepper.controller.status.solver == "solved"
        assert "ceiling l_wrist" in pepper.controller.explain()
        assert pepper.link_pose("l_wrist")[2, 3] < HEIGHT + 0.02, "measured"


def test_without_it_the_hand_goes_higher() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        assert highest(pepper) > HEIGHT + 0.05


def test_what_is_no_ceiling_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="l_wrist"):
        Ceiling("l_wirst", 1.0)
    with pytest.raises(LimitError, match="height must be above 0"):
        Ceiling("l_wrist", -1.0)
