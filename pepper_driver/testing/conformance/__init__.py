"""Tests of the contract of every backend: subclass :class:`BackendConformance`. Needs pytest.

In a file that pytest collects, such as ``test_my_robot.py``::

    from pepper_driver.backends import Backend, make_backend
    from pepper_driver.testing.conformance import BackendConformance


    class TestMyRobot(BackendConformance):
        drives = False  # it stands on a fixed base

        def make_backend(self) -> Backend:
            return make_backend("myrobot://")

What a backend cannot do, as its ``info.capabilities`` say, is not asked of it: that it says so is. The suite opens and
closes the robot some fifty times and moves every joint: for simulated robots.
"""

import pytest

_PARTS = ("abilities", "commands", "cycles", "measurements", "sequences", "states", "threads")
pytest.register_assert_rewrite(*(f"{__name__}.{part}" for part in _PARTS))  # to show values

from pepper_driver.testing.conformance.abilities import AbilityTests  # noqa: E402
from pepper_driver.testing.conformance.commands import CommandTests  # noqa: E402
from pepper_driver.testing.conformance.cycles import CycleTests  # noqa: E402
from pepper_driver.testing.conformance.measurements import MeasurementTests  # noqa: E402
from pepper_driver.testing.conformance.sequences import SequenceTests  # noqa: E402
from pepper_driver.testing.conformance.states import StateTests  # noqa: E402
from pepper_driver.testing.conformance.threads import ThreadTests  # noqa: E402

__all__ = ["BackendConformance"]


class BackendConformance(
    StateTests,
    CycleTests,
    CommandTests,
    MeasurementTests,
    AbilityTests,
    SequenceTests,
    ThreadTests,
):
    """All tests of a backend; see the module."""
