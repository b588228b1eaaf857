"""Each fault as a client of qi sees it, and what the robot did meanwhile: the black box has it, which nothing stops."""

import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import UnknownNameError, load_robot
from support.stand_in_session import connected
from support.stand_ins import let_cycles_pass, since
from support.waiting import wait_until

ROBOT = load_robot()
PREFIX = ROBOT.naoqi.prefix
JOINT = "RShoulderPitch"
PLACE = ROBOT.joint_names.index(JOINT)
ANSWER = 20_000  # [ms] for an answer that must come, on a busy machine


def key(pattern: str, joint: str = JOINT) -> str:
    return PREFIX + pattern.format(joint=joint)


POSITION = key(ROBOT.naoqi.position)
TEMPERATURE = key(ROBOT.naoqi.temperature)
GOAL = key(ROBOT.naoqi.position_command)
HARDNESS = key(ROBOT.naoqi.stiffness_command)


def order(session: Any, actuator: str, value: float) -> None:
    dcm = session.service("DCM")
    dcm.set([actuator, "ClearAll", [[value, dcm.getTime(60)]]])


# -- the robot ------------------------------------------------------------------------------------------------------


def test_dropped_samples_stand_while_the_robot_goes_on(stand_in: StandIn, session: Any) -> None:
    memory = session.service("ALMemory")
    stand_in.set_fault("dropped")
    let_cycles_pass(stand_in)  # one more is shown, and then again and again
    before = memory.getData("DCM/Time")
    let_cycles_pass(stand_in)
    assert memory.getData("DCM/Time") == before
    stand_in.clear_faults()
    assert wait_until(lambda: memory.getData("DCM/Time") != before)


def test_a_robot_asleep_takes_no_stiffness(stand_in: StandIn, session: Any) -> None:
    order(session, GOAL, 1.0)
    order(session, HARDNESS, 1.0)
    assert wait_until(lambda: stand_in.black_box(1).stiffness[0, PLACE] == 1.0)
    wheel = PREFIX + ROBOT.naoqi.wheel_speed_command.format(wheel=ROBOT.wheels.names[0])
    order(session, wheel, 1.0)
    stand_in.set_fault("asleep")
    assert wait_until(lambda: not stand_in.black_box(1).stiffness.any())
    begin = time.monotonic()
    order(session, HARDNESS, 1.0)
    let_cycles_pass(stand_in)
    box = since(stand_in, begin)
    assert not box.stiffness.any()
    assert not box.wheel_command.any()
    assert session.service("ALMemory").getData(HARDNESS) == 0.0
    stand_in.clear_faults()
    assert wait_until(lambda: stand_in.black_box(1).stiffness[0, PLACE] == 1.0)
    order(session, wheel, 0.0)


def test_a_disconnected_joint_shows_what_was_and_sinks(stand_in: StandIn, session: Any) -> None:
    """The arm was held away from where it hangs; no sample shows it go there."""
    order(session, GOAL, 0.5)
    order(session, HARDNESS, 1.0)
    assert wait_until(lambda: abs(stand_in.black_box(1).position[0, PLACE] - 0.5) < 0.05)
    stand_in.set_fault(f"disconnected:{JOINT}")
    assert wait_until(lambda: stand_in.black_box(1).stiffness[0, PLACE] == 0.0)
    assert session.service("ALMemory").getData(HARDNESS) == 1.0, (
        "what the DCM orders is another matter"
    )
    shown = session.service("ALMemory").getData(POSITION)
    begin = time.monotonic()
    assert wait_until(lambda: abs(stand_in.black_box(1).position[0, PLACE] - shown) > 0.2)
    assert session.service("ALMemory").getData(POSITION) == shown
    others = np.delete(since(stand_in, begin).position, PLACE, axis=1)
    assert np.ptp(others, axis=0).max() < 0.2  # only this one


@pytest.mark.parametrize(
    ("fault", "shows", "value"),
    [
        (f"hot:{JOINT},91", TEMPERATURE, 91.0),
        ("press:ChestBoard/Button", PREFIX + "ChestBoard/Button/Sensor/Value", 1.0),
        ("press:FrontLeft", PREFIX + "Platform/FrontLeft/Bumper/Sensor/Value", 1.0),
        ("value:Battery/Charge/Sensor/Value,0.04", PREFIX + "Battery/Charge/Sensor/Value", 0.04),
        ("value:Platform/ILS/Sensor/Value,1", PREFIX + "Platform/ILS/Sensor/Value", 1.0),
    ],
)
def test_sensors_show_the_injected_values(
    stand_in: StandIn, session: Any, fault: str, shows: str, value: float
) -> None:
    memory = session.service("ALMemory")
    before = memory.getData(shows)
    assert before != value
    stand_in.set_fault(fault)
    assert wait_until(lambda: memory.getData(shows) == value)
    stand_in.clear_faults()
    assert wait_until(lambda: memory.getData(shows) != value)


# -- NAOqi's services -----------------------------------------------------------------------------------------------


def test_services_answer_wrongly_or_not(stand_in: StandIn, session: Any) -> None:
    memory, dcm = session.service("ALMemory"), session.service("DCM")
    stand_in.set_fault("none:Temperature")
    assert memory.getListData([POSITION, TEMPERATURE])[1] is None
    stand_in.set_fault("error:DCM.getTime,text=no time")
    with pytest.raises(RuntimeError, match="no time"):
        dcm.getTime(0)
    stand_in.set_fault("wrong-type:Nao")
    assert memory.getData("RobotConfig/Body/Type") == "Nao"
    stand_in.set_fault("stall:DCM.getPrefix")
    waiting = dcm.getPrefix(_async=True)
    for _ in range(20):  # others are answered meanwhile
        assert memory.getData(POSITION) is not None
    assert waiting.isRunning()
    stand_in.clear_faults()
    assert waiting.value(ANSWER)[0] == PREFIX
    assert dcm.getTime(0)
    assert None not in memory.getListData([POSITION, TEMPERATURE])


def test_a_missing_service_is_not_listed(stand_in: StandIn, session: Any) -> None:
    stand_in.set_fault("missing:DCM")
    assert "DCM" not in [info["name"] for info in session.services()]
    with pytest.raises(RuntimeError, match="DCM"):
        session.service("DCM")
    stand_in.clear_faults()
    assert session.service("DCM").getTime(0)


# -- the process, the link ------------------------------------------------------------------------------------------


def test_a_hung_naoqi_says_nothing_and_the_robot_goes_on(stand_in: StandIn, session: Any) -> None:
    dcm = session.service("DCM")
    begin = time.monotonic()
    stand_in.set_fault("hang")
    answer = dcm.getTime(0, _async=True)
    let_cycles_pass(stand_in)
    assert answer.isRunning()
    assert session.isConnected()
    with pytest.raises(BackendError, match="NAOqi process does not answer"):
        stand_in.set_fault("none")
    stand_in.clear_faults()
    assert answer.value(ANSWER)
    assert continues(since(stand_in, begin))


def continues(box: BlackBox) -> bool:
    """Return True if the robot made cycles, each at its place in its own time."""
    return len(box) > 10 and set(np.diff(box.date) - 12 * np.diff(box.cycle)) == {0}


def test_a_killed_naoqi_comes_back_to_the_same_robot(
    qi: ModuleType, stand_in: StandIn, session: Any
) -> None:
    order(session, GOAL, 0.8)
    order(session, HARDNESS, 1.0)
    assert wait_until(lambda: abs(stand_in.black_box(1).position[0, PLACE] - 0.8) < 0.05)
    begin = time.monotonic()
    stand_in.set_fault("kill")
    assert wait_until(lambda: not session.isConnected())
    stand_in.clear_faults()
    again = qi.Session()
    again.connect(stand_in.url)
    shown = again.service("ALMemory").getData(POSITION)
    again.close()
    box = since(stand_in, begin)
    assert shown == pytest.approx(0.8, abs=0.06)
    assert continues(box)
    assert np.abs(box.position[:, PLACE] - 0.8).max() < 0.06  # it held its arm all the time


def test_a_killed_naoqi_comes_back_by_itself(stand_in: StandIn, session: Any) -> None:
    before = stand_in.naoqi_process.pid
    stand_in.set_fault("kill:seconds=0.2")
    assert wait_until(lambda: stand_in.naoqi_process.pid != before)
    assert stand_in.naoqi_process.poll() is None


def test_a_blocked_link_holds_everything_back(stand_in: StandIn, session: Any) -> None:
    dcm = session.service("DCM")
    stand_in.set_fault("blocked")
    orders = stand_in.black_box(1).orders[0]
    answer = dcm.set([HARDNESS, "ClearAll", [[0.5, stand_in.robot.time()]]], _async=True)
    with connected(f"tcp://127.0.0.1:{stand_in._naoqi_at[1]}") as past_the_link:
        for _ in range(20):  # NAOqi has the time for it
            assert past_the_link.service("DCM").getTime(0)
    let_cycles_pass(stand_in)
    assert answer.isRunning()
    assert stand_in.black_box(1).orders[0] == orders
    stand_in.clear_faults()
    answer.value(ANSWER)
    assert wait_until(lambda: stand_in.black_box(1).orders[0] == orders + 1)


def test_a_cut_link_disconnects(qi: ModuleType, stand_in: StandIn, session: Any) -> None:
    stand_in.set_fault("cut")
    assert wait_until(lambda: not session.isConnected())
    refused, another = qi.Session(), qi.Session()
    with pytest.raises(RuntimeError):
        refused.connect(stand_in.url)
    stand_in.clear_faults()
    another.connect(stand_in.url)
    another.close()


def test_a_network_is_late(stand_in: StandIn, session: Any, tmp_path: Path) -> None:
    """By far more than a busy machine is."""
    dcm, slow = session.service("DCM"), tmp_path / "slow.yaml"
    slow.write_text("name: slow\ndelay: 0.2\njitter: 0.0\nstall_probability: 0.0\nstall: 0.0\n")

    def round_trip() -> float:
        begin = time.perf_counter()
        dcm.getTime(0)
        return time.perf_counter() - begin

    stand_in.set_fault(f"network:{slow}")
    assert min(round_trip() for _ in range(3)) >= 0.4
    stand_in.clear_faults()
    assert wait_until(lambda: round_trip() < 0.2)


# -- how they are set -----------------------------------------------------------------------------------------------


def test_clients_set_faults_of_every_place(stand_in: StandIn, session: Any) -> None:
    service, memory = session.service("StandIn"), session.service("ALMemory")
    service.setFault("press", {"sensors": "Back"})
    assert wait_until(lambda: memory.getData(PREFIX + "Platform/Back/Bumper/Sensor/Value") == 1.0)
    service.setFault("none", {"keys": "Temperature"})
    assert memory.getData(TEMPERATURE) is None
    service.clearFaults()
    assert memory.getData(TEMPERATURE) is not None
    service.setFault("hang", {"seconds": 0.3})
    answer = memory.getData(POSITION, _async=True)
    assert answer.value(ANSWER) is not None  # it goes on by itself
    service.setFault("cut", {"seconds": 0.3})
    assert wait_until(lambda: not session.isConnected())


@pytest.mark.parametrize(
    ("name", "arguments", "word"),
    [
        ("hagn", {}, "did you mean hang"),
        ("hot", {"joint": "RShoulderPich"}, "did you mean RShoulderPitch"),
        ("hang", {"secs": 2.0}, "did you mean seconds"),
        ("slow", {"delay": "long"}, "delay must be a number"),
        ("press", {"sensors": "Front"}, "FrontLeft"),
        ("missing", {"service": "DMC"}, "did you mean DCM"),
        ("rollover", {}, "only at the start"),
    ],
)
def test_what_makes_no_sense_is_refused_over_qi(
    session: Any, name: str, arguments: dict[str, Any], word: str
) -> None:
    with pytest.raises(RuntimeError, match=word):
        session.service("StandIn").setFault(name, arguments)


def test_what_cannot_be_is_refused() -> None:
    plain = StandIn()
    with pytest.raises(BackendError, match="start the stand-in with the network 'clear'"):
        plain.set_fault("cut")
    with pytest.raises(BackendError, match="only at the start"):
        plain.set_fault("rollover")
    with pytest.raises(UnknownNameError, match="did you mean cut"):
        plain.set_fault("cutt")
