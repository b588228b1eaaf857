"""Faults of services: late, refused and wrong answers, for the calls that are meant and as long as they last."""

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.faults import parse_fault
from pepper_driver.backends.naoqi_server.service_faults import BODY_TYPE, ServiceFaults
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock
from support.virtual_time import VirtualTime

VALUES = {"a/Value": 1.0, "b/Value": 2.0, BODY_TYPE: "Juliette"}


class Memory:
    """As ALMemory answers."""

    calls = 0

    def getData(self, key: str) -> Any:
        self.calls += 1
        return VALUES[key]

    def getListData(self, keys: list[str]) -> list[Any]:
        return [VALUES[key] for key in keys]


class Client:
    """Calls a service as a client does."""

    def __init__(self, name: str, service: Any, faults: ServiceFaults) -> None:
        self.name, self.service, self.faults = name, service, faults

    def __getattr__(self, method: str) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            proceed = partial(getattr(self.service, method), *arguments)
            return self.faults.call(self.name, method, arguments, proceed)

        return call


def make(*texts: str, clock: Clock = MONOTONIC_CLOCK) -> tuple[ServiceFaults, Client]:
    faults = ServiceFaults(clock)
    memory = Client("ALMemory", Memory(), faults)
    for text in texts:
        faults.set(parse_fault(text))
    return faults, memory


def test_calls_of_the_stand_in_itself_pass() -> None:
    """Else no caller could clear a stall of all services."""
    faults, _ = make("stall", "error:calls=")
    assert Client("StandIn", Memory(), faults).getData("a/Value") == 1.0


def test_nothing_set_changes_nothing() -> None:
    _, memory = make()
    assert memory.getListData(list(VALUES)) == list(VALUES.values())
    assert memory.getData("a/Value") == 1.0
    assert memory.service.calls == 1


def test_none_is_for_the_keys_that_are_meant() -> None:
    faults, memory = make("none:a/")
    assert memory.getListData(list(VALUES)) == [None, 2.0, "Juliette"]
    faults.set(parse_fault("none:Body"))
    assert memory.getListData(list(VALUES)) == [None, 2.0, None]
    assert memory.getData("a/Value") is None
    assert memory.getData("b/Value") == 2.0
    faults.clear()
    assert memory.getData("a/Value") == 1.0


def test_the_robot_can_be_another() -> None:
    faults, memory = make("wrong-type:Nao")
    assert memory.getData(BODY_TYPE) == "Nao"
    assert memory.getListData(["a/Value", BODY_TYPE]) == [1.0, "Nao"]

    class Model:
        def getRobotType(self) -> str:
            return "Juliette"

        def getRobotConfig(self) -> list[list[str]]:
            return [["Model Type", "Head Version"], ["JULIETTE_Y20", "VERSION_180"]]

    model = Client("ALMotion", Model(), faults)
    assert model.getRobotType() == "Nao"
    assert model.getRobotConfig() == [["Model Type", "Head Version"], ["Nao", "VERSION_180"]]


@pytest.mark.parametrize(
    ("calls", "refused"),
    [
        ("", True),
        ("ALMemory", True),
        ("ALMemory.getData", True),
        ("DCM", False),
        ("ALMemory.getListData", False),
    ],
)
def test_errors_are_for_the_calls_that_are_meant(calls: str, refused: bool) -> None:
    _, memory = make(f"error:calls={calls},text=no reason")
    if refused:
        with pytest.raises(BackendError, match="no reason"):
            memory.getData("a/Value")
        assert memory.service.calls == 0
    else:
        assert memory.getData("a/Value") == 1.0


def test_a_fault_begins_and_ends_at_its_times() -> None:
    time = VirtualTime()
    _, memory = make("none:seconds=2,after=1", clock=time.clock())
    seen = []
    for _ in range(5):
        seen.append(memory.getData("a/Value"))
        time.sleep(0.75)
    assert seen == [1.0, 1.0, None, None, 1.0]  # at 0, 0.75, 1.5, 2.25, 3


def test_a_stalled_call_is_answered_at_the_end_and_nothing_else_waits() -> None:
    time = VirtualTime()
    faults, memory = make("stall:ALMemory.getData", clock=time.clock())
    answers: list[float] = []
    time.start(lambda: answers.append(memory.getData("a/Value")), "client")
    time.sleep(5.0)
    begin = time.seconds()
    assert memory.getListData(["b/Value"]) == [2.0]
    assert time.seconds() == begin
    assert not answers
    faults.clear()
    time.sleep(0.01)
    assert answers == [1.0]
    time.close()


@pytest.mark.parametrize(("fault", "seconds"), [("stall:seconds=0.2", 0.2), ("slow:0.1", 0.1)])
def test_a_call_that_is_held_up_takes_its_time(fault: str, seconds: float) -> None:
    time = VirtualTime()
    _, memory = make(fault, clock=time.clock())
    begin = time.seconds()
    assert memory.getData("a/Value") == 1.0
    assert time.seconds() - begin == pytest.approx(seconds, abs=0.005)
