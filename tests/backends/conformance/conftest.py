"""The suite runs on the backends of this package; with ``--backend URI`` on another one in their place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from conformance.cases import Case, by_uri, mock, mujoco, naoqi, replay
from pepper_driver.backends import Backend

FACTORIES: dict[str, Callable[[Path], Iterator[Case]]] = {
    "mock": lambda _: mock(),
    "mujoco": lambda _: mujoco(),
    "replay": replay,
    "naoqi": lambda _: naoqi(),
}
"""Makers of a case: each gets a folder for what it needs, and can clean up after its ``yield``."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """All backends, or those that the command line names."""
    if "case" in metafunc.fixturenames:
        names = metafunc.config.getoption("--backend") or list(FACTORIES)
        metafunc.parametrize("case", names, indirect=True, scope="package")


@pytest.fixture(scope="package")
def case(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Case]:
    """One after the other, each for all tests."""
    name = request.param
    if name in FACTORIES:
        yield from FACTORIES[name](tmp_path_factory.mktemp("robot"))
    else:
        yield from by_uri(name)


@pytest.fixture
def backend(case: Case) -> Iterator[Backend]:
    """A new one, closed; closed again afterwards."""
    backend = case.make()
    yield backend
    backend.close()
