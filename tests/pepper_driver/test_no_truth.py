"""Nothing that an observer sees, nor what it keeps, leads to the ground truth of a simulation."""

from __future__ import annotations

import gc
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from types import FunctionType, ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest

from pepper_driver.backends import Backend, Truth
from pepper_driver.config import PlantConfig
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.interface import Observation
from pepper_driver.robot import Pepper
from support.fusion import fusion_observer
from support.observer import ROBOT, SETTINGS, models

FORBIDDEN = (Truth, Backend, PlantConfig, Pepper, mujoco.MjData, mujoco.MjModel)
OF_THE_SIMULATION = "pepper_driver.backends.mujoco_"


def referents(thing: object) -> list[object]:
    """Contents of an object, also those that the garbage collector does not visit."""
    if isinstance(thing, type | ModuleType):
        return []
    if isinstance(thing, FunctionType):
        # Not its module, but what it has closed over.
        return [*(thing.__closure__ or ()), *(thing.__defaults__ or ())]
    found: list[object] = list(gc.get_referents(thing))
    if isinstance(thing, np.ndarray):
        found.append(thing.base)
        if thing.dtype == object:
            found += thing.ravel().tolist()
    for cls in type(thing).__mro__:
        slots = cls.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            found.append(getattr(thing, name, None))
    found.append(getattr(thing, "__dict__", None))
    return found


def reachable(*roots: object) -> list[object]:
    found: dict[int, object] = {}
    todo = list(roots)
    while todo:
        thing = todo.pop()
        if id(thing) not in found:
            found[id(thing)] = thing
            todo += referents(thing)
    return list(found.values())


def truths(*roots: object) -> list[str]:
    """Names of the types that must not be reached, and are."""
    return [
        type(thing).__qualname__
        for thing in reachable(*roots)
        if isinstance(thing, FORBIDDEN) or type(thing).__module__.startswith(OF_THE_SIMULATION)
    ]


def search(mode: str) -> tuple[list[str], list[str]]:
    """Truths that lead from a running robot, and those from what its observer has seen and keeps."""
    observer = (
        fusion_observer(adapt=True)
        if mode == "fusion"
        else ContactObserver(ROBOT, models(), SETTINGS)
    )
    seen: list[tuple[Tick, Observation | None]] = []
    with Pepper("mujoco", observer=observer) as pepper:
        pepper.set_posture({"LElbowRoll": -0.8})
        pepper.push("LForeArm", [0.0, 8.0, 0.0], delay=0.1)
        pepper.run(0.4, on_tick=lambda tick, observation: seen.append((tick, observation)))
        of_robot = truths(pepper)
    assert len(seen) > 30
    tick, observation = seen[-1]
    arrays = [thing for thing in reachable(tick) if isinstance(thing, np.ndarray)]
    assert any(array is tick.measurement.position for array in arrays)
    assert any(thing is observer for thing in reachable([observer]))
    assert observation is not None
    roots = (*seen[:: len(seen) // 3], observer)
    return of_robot, [name for root in roots for name in truths(root)]


@pytest.mark.parametrize("mode", ["paper", "fusion"])
def test_nothing_that_an_observer_sees_leads_to_the_truth(mode: str) -> None:
    """In a process of its own: other tests leave things that lead anywhere."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        of_robot, of_observer = pool.submit(search, mode).result()
    assert "MjData" in of_robot, "the search does not find it where it is"
    assert of_observer == []


class Hidden(Truth):
    """A truth that must not be found."""


Hidden.__abstractmethods__ = frozenset()


class Slotted:
    __slots__ = ("kept",)

    def __init__(self, kept: object) -> None:
        self.kept = kept

    def method(self) -> None:
        """Holds on to its object."""


def places(hidden: Any) -> list[object]:
    def closure() -> object:
        return hidden

    return [
        hidden,
        {"a": [(hidden,)]},
        Slotted(hidden),
        Slotted(hidden).method,
        closure,
        np.array([hidden], dtype=object),
        np.array([hidden], dtype=object)[:0],
    ]


@pytest.mark.parametrize("place", range(len(places(None))))
def test_the_walk_finds_truth_wherever_it_is_hidden(place: int) -> None:
    hidden = Hidden()  # type: ignore[abstract]
    assert truths(places(hidden)[place]) == ["Hidden"]
    assert truths(places(None)[place]) == []
