"""Faults of services: late, refused and wrong answers, for the calls that are meant and as long as they last."""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from pepper_driver.backends.naoqi_server.faults import parse_fault
from pepper_driver.backends.naoqi_server.service_faults import BODY_TYPE, ServiceFaults

VALUES = {"a/Value": 1.0, "b/Value": 2.0, BODY_TYPE: "Juliette"}


class Memory:
    """As ALMemory answers."""

    calls = 0

    def getData(self, key: str) -> Any:
        self.calls += 1
        return VALUES[key]

    def getListData(self, keys: list[str]) -> list[Any]:
        return [VALUES[key] for key in keys]


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def make(*texts: str, clock: Callable[[], float] = time.monotonic) -> tuple[ServiceFaults, Any]:
    faults = ServiceFaults(clock)
    memory = faults.wrapped("ALMemory", Memory())
    for text in texts:
        faults.set(parse_fault(text))
    return faults, memory


def test_nothing_set_changes_nothing() -> None:
    _, memory = make()
    assert memory.getListData(list(VALUES)) == list(VALUES.values())
    assert memory.getData("a/Value") == 1.0
    assert memory.calls == 1


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

    model: Any = faults.wrapped("ALMotion", Model())
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
        with pytest.raises(RuntimeError, match=r"ALMemory::getData\n\tno reason"):
            memory.getData("a/Value")
        assert memory.calls == 0
    else:
        assert memory.getData("a/Value") == 1.0


def test_a_fault_begins_and_ends_at_its_times() -> None:
    clock = Clock()
    _, memory = make("none:seconds=2,after=1", clock=clock)
    seen = []
    for _ in range(5):
        seen.append(memory.getData("a/Value"))
        clock.now += 0.75
    assert seen == [1.0, 1.0, None, None, 1.0]  # at 0, 0.75, 1.5, 2.25, 3


def test_a_stalled_call_is_answered_at_the_end_and_nothing_else_waits() -> None:
    faults, memory = make("stall:ALMemory.getData")
    answers: list[float] = []
    thread = threading.Thread(target=lambda: answers.append(memory.getData("a/Value")), daemon=True)
    thread.start()
    assert memory.getListData(["b/Value"]) == [2.0]
    thread.join(0.2)
    assert not answers
    faults.clear()
    thread.join(10.0)
    assert answers == [1.0]


def test_a_stall_ends_by_itself() -> None:
    _, memory = make("stall:seconds=0.2")
    begin = time.monotonic()
    assert memory.getData("a/Value") == 1.0
    assert time.monotonic() - begin >= 0.2


def test_a_slow_call_takes_its_time_longer() -> None:
    _, memory = make("slow:0.1")
    begin = time.monotonic()
    assert memory.getData("a/Value") == 1.0
    assert time.monotonic() - begin >= 0.1


def test_services_keep_their_signatures_on_the_wire() -> None:
    """Overloads, declared types, numbers of parameters and signals are what qi makes of the class itself."""
    qi = pytest.importorskip("qi")

    class Service:
        def __init__(self) -> None:
            self.happened = qi.Signal("(i)")

        def two(self, a: int, b: int) -> list[int]:
            return [a, b]

        def any(self, *arguments: int) -> list[int]:
            return list(arguments)

        @qi.bind(qi.Float, [qi.String], "insert")  # type: ignore[untyped-decorator]
        def _one(self, key: str) -> float:
            return 0.1

        @qi.bind(qi.Int32, [qi.String, qi.Int32], "insert")  # type: ignore[untyped-decorator]
        def _two(self, key: str, value: int) -> int:
            self.happened(value)
            return value

    faults = ServiceFaults()
    server, client = qi.Session(), qi.Session()
    server.listenStandalone("tcp://127.0.0.1:0")
    plain = Service()
    server.registerService("Plain", plain)
    server.registerService("Wrapped", faults.wrapped("Wrapped", Service()))
    client.connect(server.endpoints()[-1])
    try:
        seen: queue.SimpleQueue[int] = queue.SimpleQueue()
        methods = []
        for name in ("Plain", "Wrapped"):
            service = client.service(name)
            found = service.metaObject()
            methods.append(str(found).replace(name, ""))
            service.happened.connect(seen.put)
            assert service.two(1, 2) == [1, 2]
            assert service.any(1, 2, 3) == [1, 2, 3]
            assert service.insert("k") == pytest.approx(0.1)
            assert service.insert("k", 7) == 7
            assert seen.get(timeout=10.0) == 7
        assert methods[0] == methods[1]
        faults.set(parse_fault("error:Wrapped.insert"))
        with pytest.raises(RuntimeError, match="Wrapped::insert"):
            client.service("Wrapped").insert("k")
    finally:
        client.close()
        server.close()
