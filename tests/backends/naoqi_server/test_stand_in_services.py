"""DCM, ALMemory and StandIn over the real qi, as programs for the robot use them."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.launch import StandIn
from support.stand_in_session import PREFIX, connected
from support.waiting import wait_until

HEAD = f"{PREFIX}HeadYaw/Position/Actuator/Value"


@pytest.fixture(scope="module")
def stand_in(qi: object) -> Iterator[StandIn]:
    with StandIn("mujoco://?seed=3") as made:
        yield made


@pytest.fixture(scope="module")
def session(stand_in: StandIn) -> Iterator[Any]:
    with connected(stand_in.url) as made:
        yield made


@pytest.fixture(scope="module")
def dcm(session: Any) -> Any:
    return session.service("DCM")


@pytest.fixture(scope="module")
def memory(session: Any) -> Any:
    return session.service("ALMemory")


@pytest.fixture
def outside(session: Any) -> Iterator[Any]:
    """The service StandIn, all well again afterwards."""
    service = session.service("StandIn")
    yield service
    service.clearFaults()


def test_prefix_and_time(dcm: Any, memory: Any) -> None:
    assert dcm.getPrefix() == ["Device/SubDeviceList/", "Device/DeviceList/"]
    before, ahead, after = dcm.getTime(0), dcm.getTime(1000), dcm.getTime(0)
    assert 0 <= wrapped(ahead - 1000 - before) <= wrapped(after - before)
    assert dcm.getTime(-1000) < before
    assert isinstance(memory.getData("DCM/Time"), int)
    assert isinstance(memory.getListData(["DCM/Time"])[0], int)
    assert wait_until(lambda: wrapped(memory.getData("DCM/Time") - before) >= 0)
    sample = memory.getData("DCM/Time")
    assert wrapped(dcm.getTime(0) - sample) >= 0, "no sample is of a cycle to come"


def test_the_clock_and_the_samples_go_at_the_pace_of_time(dcm: Any, memory: Any) -> None:
    def now() -> tuple[float, int, float]:
        """The DCM's time, and ours before and after it was asked for [ms]."""
        before, shown = 1000 * time.monotonic(), dcm.getTime(0)
        return before, shown, 1000 * time.monotonic()

    sample, (before, first, after) = memory.getData("DCM/Time"), now()
    time.sleep(0.5)
    later_before, second, later_after = now()
    passed = wrapped(second - first)
    assert later_before - after - 1 <= passed <= later_after - before + 1
    assert wait_until(lambda: wrapped(memory.getData("DCM/Time") - second) >= 0)
    newest = memory.getData("DCM/Time")
    assert wrapped(dcm.getTime(0) - newest) >= 0
    assert wrapped(newest - sample) % 12 == 0, "dates are those of cycles"


def test_an_alias_names_actuators_that_do_not_exist(dcm: Any) -> None:
    asked = ["HeadYaw/Position/Actuator/Value", HEAD, "Tail/Position/Actuator/Value"]
    assert dcm.createAlias(["some", asked]) == ["some", [*asked[:2], ""]]
    sensor = f"{PREFIX}HeadYaw/Position/Sensor/Value"
    assert dcm.createAlias(["some", [sensor]]) == ["some", [""]]


def test_orders_reach_the_actuators(dcm: Any, memory: Any) -> None:
    """``set`` of one actuator with and without prefix and of an alias, ``setAlias`` in both formats."""
    red, green, blue = (f"ChestBoard/Led/{c}/Actuator/Value" for c in ("Red", "Green", "Blue"))

    def leds() -> list[float]:
        values: list[float] = memory.getListData([PREFIX + led for led in (red, green, blue)])
        return values

    dcm.set([red, "ClearAll", [[0.5, dcm.getTime(0)]]])
    dcm.set([PREFIX + green, "ClearAll", [[0.25, dcm.getTime(0), 0]]])
    assert wait_until(lambda: leds() == [0.5, 0.25, 0.0])
    dcm.createAlias(["Chest", [red, green, blue]])
    dcm.set(["Chest", "ClearAll", [[1, dcm.getTime(0)]]])
    assert wait_until(lambda: leds() == [1.0, 1.0, 1.0])
    now = dcm.getTime(0)
    dcm.setAlias(["Chest", "ClearAll", "time-mixed", [[[0.1, now]], [[0.2, now, 0]], []]])
    assert wait_until(lambda: leds() == [0.1, 0.2, 1.0])
    dcm.setAlias(
        ["Chest", "ClearAll", "time-separate", 0, [now, now + 1], [[0, 0.3], [0, 0.4], [0, 0.5]]]
    )
    assert wait_until(lambda: leds() == [0.3, 0.4, 0.5])


@pytest.mark.parametrize(
    ("method", "request_", "words"),
    [
        ("set", ["Tail", "Merge", []], "no actuator or alias 'Tail'"),
        ("set", [HEAD, "Clear", []], "possible: Merge, ClearAll, ClearAfter, ClearBefore"),
        ("set", [HEAD, "Merge", [["1", 2]]], "finite number"),
        ("setAlias", [HEAD, "Merge", "time-mixed", [[]]], "no actuator or alias"),
        ("setAlias", ["Chest", "Merge", "time-mixed", [[]]], "3 actuators, and there are 1 lists"),
        ("createAlias", ["Chest"], "expected"),
        ("getTime", "now", "whole number"),
        ("set", [HEAD, "ClearAll", [[1.0, 10**8 + n] for n in range(513)]], "buffer holds 512"),
    ],
)
def test_what_the_dcm_refuses(dcm: Any, method: str, request_: object, words: str) -> None:
    dcm.createAlias(["Chest", [f"ChestBoard/Led/{c}/Actuator/Value" for c in ("Red", "Blue", "x")]])
    with pytest.raises(RuntimeError, match=words) as error:
        getattr(dcm, method)(request_)
    assert str(error.value).startswith(f"DCM::{method}: ")
    assert "\n" not in str(error.value)


def test_a_whole_choreography_in_one_request(dcm: Any, memory: Any) -> None:
    """More than one packet between the processes: 512 commands for each of 80 lights."""
    lights = [name for name in memory.getDataList("Led/") if "Actuator" in name][:68]
    dcm.createAlias(["lights", lights])
    now = dcm.getTime(1000)
    its = [[(n % 7) / 7, now + n] for n in range(511)] + [[0.75, now + 511]]
    dcm.setAlias(["lights", "ClearAll", "time-mixed", [its] * len(lights)])
    assert wait_until(lambda: set(memory.getListData(lights)) == {0.75})


def test_values_of_keys(memory: Any, stand_in: StandIn) -> None:
    names = memory.getDataListName()
    assert len([name for name in names if name.startswith(PREFIX)]) == 552
    values = memory.getListData(names)
    assert None not in [v for n, v in zip(names, values, strict=True) if n.startswith(PREFIX)]
    assert memory.getData("RobotConfig/Body/Type") == "Juliette"
    assert memory.getData("Device/DeviceList/ChestBoard/BodyId") == stand_in.robot.info["identity"]
    assert memory.getData("DCM/Time", 0) > -(2**31), "as old programs call it"
    sensors = memory.getDataList("Touch/Front")
    assert sensors == [f"{PREFIX}Head/Touch/Front/Sensor/Value"]
    assert memory.getListData([sensors[0], "no such key"]) == [0.0, None]
    with pytest.raises(RuntimeError, match="ALMemory::getData: no data under 'no such key'"):
        memory.getData("no such key")
    with pytest.raises(RuntimeError, match="expected a list"):
        memory.getListData("DCM/Time")
    with pytest.raises(RuntimeError, match="expected text"):
        memory.getData(3)


def test_data_of_ones_own(memory: Any) -> None:
    for value in (1, 2.5, "text", [1, ["a", 2.0]], None, True):
        memory.insertData("My/Key", value)
        assert memory.getData("My/Key") == value
    memory.insertListData([["My/Key", 1], ["My/Other", "x"]])
    assert memory.getListData(["My/Other", "My/Key"]) == ["x", 1]
    value, seconds, micro = memory.getTimestamp("My/Key")
    assert value == 1
    assert abs(seconds + micro * 1e-6 - time.time()) < 60
    assert memory.getDataList("My/") == ["My/Key", "My/Other"]
    assert memory.getType("My/Key") == "Data"
    memory.removeData("My/Key")
    assert memory.getDataList("My/") == ["My/Other"]
    with pytest.raises(RuntimeError, match="My/Key"):
        memory.removeData("My/Key")


def test_the_robot_overwrites_what_is_put_under_its_keys(memory: Any) -> None:
    key = f"{PREFIX}HeadYaw/Position/Sensor/Value"
    memory.insertData(key, 99.0)
    assert wait_until(lambda: memory.getData(key) != 99.0)
    assert memory.getDataListName().count(key) == 1


def test_events(memory: Any) -> None:
    received: list[object] = []
    subscriber = memory.subscriber("My/Event")
    link = subscriber.signal.connect(received.append)
    memory.raiseEvent("My/Event", [1, "a"])
    memory.insertData("My/Event", "no event")
    assert wait_until(lambda: received == [[1, "a"]]), received
    memory.raiseMicroEvent("My/Event", 2.5)
    assert wait_until(lambda: received == [[1, "a"], 2.5]), received
    assert memory.getData("My/Event") == 2.5
    subscriber.signal.disconnect(link)
    memory.declareEvent("My/Declared")
    memory.declareEvent("My/ByOne", "Extractor")
    assert {"My/Declared", "My/ByOne", "TouchChanged"} <= set(memory.getEventList())
    assert "My/Event" in memory.getMicroEventList()
    assert memory.getType("My/Declared") == "Event"


def test_methods_of_services_as_listeners(session: Any, memory: Any) -> None:
    """The old way: a service of the client is called by name."""
    received: list[tuple[object, ...]] = []

    class Listener:
        def on_event(self, name: str, value: object, message: str) -> None:
            received.append((name, value, message))

    number = session.registerService("Test-Listener", Listener())
    memory.subscribeToEvent("My/Old", "Test-Listener", "on_event")
    memory.subscribeToMicroEvent("My/Micro", "Test-Listener", "word", "on_event")
    assert memory.getSubscribers("My/Old") == ["Test-Listener"]
    memory.raiseEvent("My/Old", 1)
    memory.raiseMicroEvent("My/Micro", 2)
    assert wait_until(lambda: len(received) == 2)
    assert sorted(received) == [("My/Micro", 2, "word"), ("My/Old", 1, "")]
    memory.unsubscribeToEvent("My/Old", "Test-Listener")
    memory.subscribeToEvent("My/Old2", "Test-Listener", "on_event")
    memory.raiseEvent("My/Old", 3)
    memory.raiseEvent("My/Old2", 4)
    assert wait_until(lambda: len(received) == 3)
    assert received[-1] == ("My/Old2", 4, "")
    session.unregisterService(number)
    memory.raiseEvent("My/Old2", 5)  # no subscriber is left, and no error comes


def test_sensors_raise_events(memory: Any, outside: Any) -> None:
    received: list[tuple[str, object]] = []

    def listen(name: str) -> Any:
        subscriber = memory.subscriber(name)
        subscriber.signal.connect(lambda value: received.append((name, value)))
        return subscriber

    names = ("FrontTactilTouched", "HandRightBackTouched", "BackBumperPressed", "TouchChanged")
    subscribers = [listen(name) for name in names]
    outside.setFault("press", {"sensors": "Head/Touch/Front+Back"})
    pressed = {("FrontTactilTouched", 1.0), ("BackBumperPressed", 1.0)}
    touched = ("TouchChanged", [["Head/Touch/Front", True], ["Bumper/Back", True]])
    assert wait_until(lambda: len(received) == 3)
    assert all(event in received for event in (*pressed, touched))
    assert memory.getData("FrontTactilTouched") == 1.0
    outside.clearFaults()
    assert wait_until(lambda: len(received) == 6)
    assert ("TouchChanged", [["Head/Touch/Front", False], ["Bumper/Back", False]]) in received[3:]
    del subscribers


def test_clicks_of_the_chest_button(memory: Any, outside: Any) -> None:
    received: list[str] = []
    subscribers = []
    for name in ("Simple", "Double"):
        subscribers.append(memory.subscriber(f"ALChestButton/{name}ClickOccurred"))
        subscribers[-1].signal.connect(lambda _, name=name: received.append(name))
    for _ in range(2):
        outside.setFault("press", {"sensors": "ChestBoard/Button"})
        assert wait_until(lambda: memory.getData("ChestButtonPressed") == 1.0)
        outside.clearFaults()
        assert wait_until(lambda: memory.getData("ChestButtonPressed") == 0.0)
    assert wait_until(lambda: received in (["Double"], ["Simple", "Simple"])), received


def test_pushes_and_truth(outside: Any, stand_in: StandIn) -> None:
    info = outside.info()
    assert info["pid"] == stand_in.robot_process.pid
    assert info["plant"] == "nominal"
    (before,) = stand_in.black_box(1).position[:, 5]
    (begin,) = stand_in.black_box(1).cycle

    def swing() -> float:
        """Largest way of the arm from there since then [rad]."""
        box = stand_in.black_box()
        return float(np.abs(box.position[box.cycle >= begin, 5] - before).max())

    outside.push({"link": "LBicep", "force": [30.0, 0.0, 0.0], "duration": 0.5})
    outside.grab({"link": "RBicep", "pull": [0.0, -0.05, 0.0], "hold": 0.2})
    assert wait_until(lambda: swing() > 0.05)
    with pytest.raises(RuntimeError, match="did you mean LBicep"):
        outside.push({"link": "LBicp", "force": [1.0, 0.0, 0.0]})
    with pytest.raises(RuntimeError, match="unknown fault"):
        outside.setFault("flu", {})
    rows = outside.blackBox(4)
    assert [len(rows[name]) for name in ("date", "position", "wheel_speed")] == [4, 4, 4]
    assert len(rows["position"][0]) == 17


def test_calls_are_slow_when_requested(dcm: Any, outside: Any) -> None:
    outside.setFault("slow", {"calls": "DCM.getTime", "delay": 0.3})
    begin = time.monotonic()
    dcm.getTime(0)
    assert time.monotonic() - begin >= 0.3
    outside.clearFaults()
    with pytest.raises(RuntimeError, match="did you mean delay"):
        outside.setFault("slow", {"dely": 0.3})


def test_private_methods_are_not_shown(dcm: Any) -> None:
    methods = {method["name"] for method in dcm.metaObject()["methods"].values()}
    own = {"getPrefix", "getTime", "createAlias", "set", "setAlias"}
    assert own <= methods
    assert not [name for name in methods if name.startswith("_")]
