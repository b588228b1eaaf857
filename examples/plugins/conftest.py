"""The tests of these packages, run in a checkout: as if the packages were installed."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _installed(example_plugins: None) -> None:
    return
