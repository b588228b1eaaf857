"""One worker is one core."""

from collections.abc import Iterable

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from pepper_driver.config.workers import one_core, run_jobs


def threads() -> set[int]:
    np.ones((2, 2)) @ np.ones((2, 2))
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture
def several() -> Iterable[None]:
    """Tests themselves are bound to one thread."""
    with threadpool_limits(limits=2):
        yield


@pytest.mark.usefixtures("several")
def test_one_worker_does_its_algebra_in_one_thread() -> None:
    assert threads() == {2}
    assert list(run_jobs([threads, threads], workers=1)) == [{1}, {1}]
    assert 2 in threads(), "again; a library that came meanwhile keeps its own number"
    with one_core(1):
        assert threads() == {1}
    with one_core(2):
        assert 2 in threads()


@pytest.mark.usefixtures("several")
def test_a_library_that_comes_later_is_bound_too() -> None:
    with one_core(1):
        import scipy.linalg

        scipy.linalg.svd(np.ones((3, 3)))
        assert threads() == {1}
        assert len(threadpool_info()) >= 2
