"""The robot goes on whatever happens to NAOqi, and nothing outlives the process that started it."""

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import UnknownNameError
from support.processes import suspend
from support.stand_in_session import PREFIX, alive, connected
from support.stand_ins import let_cycles_pass, since
from support.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.usefixtures("qi")

WHEELS = ("WheelFL", "WheelFR", "WheelB")
SPEEDS = [f"{PREFIX}{wheel}/Speed/Actuator/Value" for wheel in WHEELS]

START_TIME = str(4 * PATIENCE)  # [s] that its processes may take
OWNER = """
import sys, time
from pepper_driver.backends.naoqi_server import ipc
from pepper_driver.backends.naoqi_server.launch import StandIn
ipc.START_TIME = float(sys.argv[2])
with StandIn("mujoco", outlive=float(sys.argv[1])) as stand_in:
    print(stand_in.robot_process.pid, stand_in.naoqi_process.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture(scope="module")
def stand_in(qi: object) -> Iterator[StandIn]:
    """One for all tests that leave it as they found it."""
    with StandIn("mujoco://?seed=3") as made:
        yield made


def drive(session: Any) -> tuple[int, int]:
    """Turn on the spot, faster and faster for two minutes; returns when that begins and ends, by the DCM's clock."""
    dcm = session.service("DCM")
    dcm.createAlias(["stiff", [f"{wheel}/Stiffness/Actuator/Value" for wheel in WHEELS]])
    dcm.createAlias(["speed", SPEEDS])
    now = dcm.getTime(0)
    dcm.set(["stiff", "ClearAll", [[1.0, now]]])
    begin, end = wrapped(now + 50), wrapped(now + 120_000)
    dcm.set(["speed", "ClearAll", [[1.0, begin], [2.0, end]]])
    return begin, end


def is_driving(stand_in: StandIn) -> bool:
    return bool(np.abs(stand_in.black_box(1).wheel_speed).min() > 0.5)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_robot_goes_on_when_naoqi_dies_or_hangs(
    stand_in: StandIn, number: signal.Signals
) -> None:
    """Orders are carried out as long as they last: here, that the wheels turn faster and faster."""
    with connected(stand_in.url) as session:
        begin, end = drive(session)
        assert wait_until(lambda: is_driving(stand_in))
        stand_in.signal_naoqi(number)
    killed = time.monotonic()
    let_cycles_pass(stand_in, 50)
    box = since(stand_in, killed)
    expected = 1.0 + (box.date - begin) / (end - begin)
    assert box.wheel_command == pytest.approx(np.tile(expected[:, None], 3), abs=1e-9)
    assert np.abs(box.wheel_speed).min() > 0.5
    stand_in.robot.order(SPEEDS, "ClearAll", [[(0.0, stand_in.robot.time())]] * 3)
    assert wait_until(lambda: not stand_in.black_box(1).wheel_command.any())
    if number == signal.SIGSTOP:
        stand_in.signal_naoqi(signal.SIGCONT)
    else:
        stand_in.start_naoqi()
    with connected(stand_in.url) as session:
        assert wrapped(session.service("DCM").getTime(0) - begin) > 0


def test_a_new_naoqi_finds_the_same_robot(stand_in: StandIn) -> None:
    with connected(stand_in.url) as session:
        dcm = session.service("DCM")
        dcm.set(["ChestBoard/Led/Red/Actuator/Value", "ClearAll", [[0.5, dcm.getTime(0)]]])
        before = dcm.getTime(0)
        port = stand_in.port
        stand_in.naoqi_process.kill()
        assert wait_until(lambda: not session.isConnected())
    stand_in.start_naoqi()
    assert stand_in.port == port
    with connected(stand_in.url) as session:
        memory = session.service("ALMemory")
        assert memory.getData(f"{PREFIX}ChestBoard/Led/Red/Actuator/Value") == 0.5
        dcm = session.service("DCM")
        assert 0 < dcm.getTime(0) - before < 60_000, "one clock"
        dcm.set(["ChestBoard/Led/Red/Actuator/Value", "ClearAll", [[0.75, dcm.getTime(0)]]])
        assert wait_until(
            lambda: memory.getData(f"{PREFIX}ChestBoard/Led/Red/Actuator/Value") == 0.75
        )


def test_a_killed_client_is_no_matter(stand_in: StandIn) -> None:
    client = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import qi, sys, time\ns = qi.Session(); s.connect(sys.argv[1]); d = s.service('DCM')\n"
            "print('on', flush=True)\nwhile True: d.getTime(0)",
            stand_in.url,
        ],
        stdout=subprocess.PIPE,
        env={**os.environ, "QI_LOG_LEVEL": "0"},
    )
    assert client.stdout is not None
    assert client.stdout.readline().strip() == b"on"
    client.kill()
    client.wait()
    client.stdout.close()
    with connected(stand_in.url) as session:
        assert session.service("DCM").getTime(0) != 0


def test_orders_fail_in_one_line_when_the_robot_has_ended() -> None:
    with StandIn() as stand_in, connected(stand_in.url) as session:
        stand_in.robot_process.kill()
        stand_in.robot_process.wait()
        with pytest.raises(RuntimeError, match="robot process has ended"):
            session.service("DCM").set(["HeadYaw/Hardness/Actuator/Value", "ClearAll", []])
        with pytest.raises(BackendError, match="robot process ended by signal 9"):
            stand_in.wait()
    assert len(stand_in.black_box()) > 0, "what it did is still known"


def test_the_robot_goes_on_whatever_it_is_asked(stand_in: StandIn) -> None:
    before = stand_in.black_box(1).cycle[-1]
    for what, arguments in (
        ("dance", {}),
        ("order", {"actuators": ["Tail"], "update": "Merge", "commands": [[]]}),
        ("order", {"actuators": [], "update": "Never", "commands": []}),
        ("push", {"link": "LBicep"}),
        ("push", {"link": "LBicep", "force": "hard"}),
    ):
        with pytest.raises(BackendError):
            stand_in.robot.ask(what, **arguments)
    assert wait_until(lambda: stand_in.black_box(1).cycle[-1] > before + 20)


def test_a_robot_process_that_was_stopped_leaves_cycles_out(stand_in: StandIn) -> None:
    suspend(stand_in.robot_process.pid)
    with connected(stand_in.url) as session:
        memory = session.service("ALMemory")

        def stamp() -> float:
            """Time of the newest sample [s]; it is its age before now, so late where one is held up in between."""
            stamps = [
                memory.getTimestamp(f"{PREFIX}HeadYaw/Position/Sensor/Value") for _ in range(20)
            ]
            return min(float(seconds + 1e-6 * micro) for _, seconds, micro in stamps)

        first = stamp()
        time.sleep(0.5)  # more cycles than it catches up with
        assert wait_until(lambda: abs(stamp() - first) < 0.02)
    os.kill(stand_in.robot_process.pid, signal.SIGCONT)
    assert wait_until(lambda: np.diff(stand_in.black_box().cycle).max() > 30)
    box = stand_in.black_box()
    np.testing.assert_array_equal(np.diff(box.date), 12 * np.diff(box.cycle))
    now = stand_in.robot.time()
    assert wait_until(lambda: stand_in.black_box(1).date[0] >= now)


def test_both_end_with_the_block() -> None:
    with StandIn() as stand_in:
        pids = stand_in.robot_process.pid, stand_in.naoqi_process.pid
        os.kill(pids[1], signal.SIGSTOP)  # even so
        begin = time.monotonic()
    assert time.monotonic() - begin < PATIENCE
    assert not any(alive(pid) for pid in pids)


@pytest.mark.parametrize("stopped", [False, True])
def test_both_end_when_their_owner_is_killed(stopped: bool) -> None:
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, "0.2", START_TIME], stdout=subprocess.PIPE
    )
    assert owner.stdout is not None
    robot, naoqi = map(int, owner.stdout.readline().split())
    if stopped:
        os.kill(naoqi, signal.SIGSTOP)
    owner.kill()
    owner.wait()
    owner.stdout.close()
    assert wait_until(lambda: not alive(robot) and not alive(naoqi))


def test_the_robot_outlives_its_owner_for_as_long_as_configured() -> None:
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, "1.5", START_TIME], stdout=subprocess.PIPE
    )
    assert owner.stdout is not None
    robot, naoqi = map(int, owner.stdout.readline().split())
    begin = time.monotonic()
    owner.kill()
    owner.wait()
    owner.stdout.close()
    assert wait_until(lambda: not alive(naoqi))
    assert wait_until(lambda: not alive(robot))
    assert time.monotonic() - begin > 1.5


def test_what_cannot_start() -> None:
    with pytest.raises(UnknownNameError, match=r"possible: .*nominal"):
        StandIn("mujoco://?plant=nix")
    with pytest.raises(UnknownNameError, match="unknown backend"):
        StandIn("nix://")
    with pytest.raises(BackendError, match="there must be a simulated robot"):
        StandIn("mock")
    with StandIn() as first, pytest.raises(BackendError, match="Address already in use") as error:
        StandIn(port=first.port).start()
    assert "\n" not in str(error.value)


def test_nothing_stays_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    with StandIn() as stand_in:
        stand_in.naoqi_process.kill()
        stand_in.start_naoqi()
    assert len(stand_in.black_box()) > 0
    del stand_in
    gc.collect()  # the table is mapped as long as a caller may look at the black box
    assert len(os.listdir("/proc/self/fd")) <= before
