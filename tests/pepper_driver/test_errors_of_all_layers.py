"""Errors of all layers: each is also one of Python's, and keeps message and data on the way between processes."""

from __future__ import annotations

import pytest

from pepper_driver.backends.naoqi.qi_library import NoQiError
from pepper_driver.config import PepperError
from pepper_driver.controller import GainError, LimitError, TargetError
from pepper_driver.log import LogError
from pepper_driver.safety import Fault, FaultError, FaultReason
from support.errors import is_copy, sent


def leaves(root: type[PepperError]) -> list[type[PepperError]]:
    below = [leaf for child in root.__subclasses__() for leaf in leaves(child)]
    return below or [root]


EXAMPLES: list[PepperError] = [
    NoQiError("another computer", possible=False),
    FaultError(Fault(reason=FaultReason.TEMPERATURE, text="a joint is on fire")),
    GainError("stiffness", -1.0),
    LimitError("fraction", -1.0, "above 0"),
    TargetError("no", joint="HeadYaw", value=9.0, lower=-1.0, upper=1.0),
    LogError("disk full"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_an_error_survives_the_way_from_a_worker(error: PepperError) -> None:
    assert is_copy(sent(error), error)


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
