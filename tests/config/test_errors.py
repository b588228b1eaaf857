"""Errors keep message and data on the way between processes, and name choices and differences in words."""

from types import SimpleNamespace

import pytest

from pepper_driver.config import ConfigError, MissingExtraError, PepperError, UnknownNameError
from pepper_driver.config.errors import first_difference
from support.errors import is_copy, sent

EXAMPLES: list[PepperError] = [
    UnknownNameError("joint", "LShoulderRol", ["LShoulderRoll", "HeadYaw"]),
    MissingExtraError("plotting", "plot"),
    ConfigError("file: key"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_an_error_survives_the_way_from_a_worker(error: PepperError) -> None:
    assert is_copy(sent(error), error)


def test_a_suggestion_names_each_choice_once() -> None:
    assert str(UnknownNameError("x", "ab", ["abc", "abc"])).count("did you mean abc?") == 1


def test_the_first_difference_is_spoken_of_in_words() -> None:
    compared = {"seed": "with the seed", "joints": "of the joints", "weight": "with the weight"}
    there = SimpleNamespace(seed=1, joints=(), weight=None, other=1)
    assert first_difference(there, SimpleNamespace(**vars(there) | {"other": 2}), compared) is None
    for changes, words in (
        ({"weight": 0.5, "seed": 2}, "with the seed 1, not 2"),
        ({"joints": ("HeadYaw", "HeadPitch")}, "of the joints none, not HeadYaw, HeadPitch"),
        ({"weight": 0.5}, "with the weight none, not 0.5"),
    ):
        asked = SimpleNamespace(**vars(there) | changes)
        assert first_difference(there, asked, compared) == words
