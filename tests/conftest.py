"""Settings of all tests, and the stand-in robot that many of them share."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from typing import Any

# Before NumPy is imported: a worker of pytest-xdist has no second processor, and threads of its algebra wait for one.
for library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, Phase, settings

import pepper_driver.controller  # noqa: F401 before a test imports pinocchio
from pepper_driver.backends.naoqi.qi_library import NoQiError, load_qi
from pepper_driver.backends.naoqi_server import ipc
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import kernels
from support.examples import CI_EXAMPLES
from support.waiting import PATIENCE

# What thousands of tests keep is not to be searched for garbage every few of them.
gc.set_threshold(5_000, 10, 20)

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

# How long an example takes depends on the machine and its load. ``ci`` draws the same examples each time, so that a
# failure is of the change under test; ``nightly`` (make test-all) draws new and ten times as many ones; ``mutation`` is
# as ``ci``, and looks for no smaller example of a failure.
ANY_MACHINE = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", ANY_MACHINE, derandomize=True)
settings.register_profile("nightly", ANY_MACHINE, max_examples=10 * CI_EXAMPLES)
settings.register_profile(
    "mutation", ANY_MACHINE, derandomize=True, phases=[Phase.explicit, Phase.generate]
)
settings.load_profile("ci")


@pytest.fixture(autouse=True, scope="session")
def _patient_start() -> Iterator[None]:
    """Processes of a stand-in may take their time to start, as the imports of a busy machine do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ipc, "START_TIME", 4 * PATIENCE)
        yield


@pytest.fixture(autouse=True, scope="session")
def _kernels_compile_silently() -> Iterator[None]:
    """The first test that needs a kernel must not show a line that its neighbours do not show."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "_announce", lambda: None)
        yield


@pytest.fixture(scope="session")
def qi() -> Any:
    """NAOqi's library, for which there is no package for every computer."""
    try:
        return load_qi()
    except NoQiError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def wake_up(qi: Any) -> Callable[[StandIn], None]:
    """Wakes a robot up, as its owner does before a program begins."""

    def wake(robot: StandIn) -> None:
        session = qi.Session()
        session.connect(robot.url)
        session.service("ALMotion").wakeUp()
        session.close()

    return wake


@pytest.fixture(scope="module")
def stand_in(qi: Any) -> Iterator[StandIn]:
    with StandIn("mujoco://?seed=3", network="clear") as running:
        yield running


@pytest.fixture
def session(qi: Any, stand_in: StandIn) -> Iterator[Any]:
    """A client, on a stand-in with nothing wrong before and afterwards."""
    stand_in.clear_faults()
    made = qi.Session()
    made.connect(stand_in.url)
    yield made
    made.close()
    stand_in.clear_faults()
