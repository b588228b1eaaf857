"""Errors keep message and data on the way between processes."""

from multiprocessing import Pipe
from types import SimpleNamespace

import pytest

from pepper_driver.backends.naoqi.qi_library import NoQiError
from pepper_driver.config import ConfigError, MissingExtraError, PepperError, UnknownNameError
from pepper_driver.config.errors import first_difference
from pepper_driver.controller import GainError, LimitError, TargetError
from pepper_driver.log import LogError
from pepper_driver.safety import Fault, FaultError, FaultReason


def leaves(root: type[PepperError]) -> list[type[PepperError]]:
    below = [leaf for child in root.__subclasses__() for leaf in leaves(child)]
    return below or [root]


EXAMPLES: list[PepperError] = [
    UnknownNameError("joint", "LShoulderRol", ["LShoulderRoll", "HeadYaw"]),
    MissingExtraError("plotting", "plot"),
    NoQiError("another computer", possible=False),
    FaultError(Fault(reason=FaultReason.TEMPERATURE, text="a joint is on fire")),
    GainError("stiffness", -1.0),
    LimitError("share", -1.0, "above 0"),
    TargetError("no", joint="HeadYaw", value=9.0, lower=-1.0, upper=1.0),
    ConfigError("file: key"),
    LogError("disk full"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_an_error_survives_the_way_from_a_worker(error: PepperError) -> None:
    here, there = Pipe()
    there.send(error)
    copy = here.recv()
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


def test_every_leaf_is_also_a_builtin_error() -> None:
    builtin = (
        ValueError,
        TypeError,
        LookupError,
        ImportError,
        OSError,
        RuntimeError,
        NotImplementedError,
    )
    for leaf in leaves(PepperError):
        if leaf.__module__.startswith("pepper_driver"):
            assert issubclass(leaf, builtin), leaf


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
