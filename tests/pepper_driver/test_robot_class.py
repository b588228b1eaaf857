"""The facade, as a user meets it, on the simulated robot."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Contact, FaultError, Hold, Pepper, PepperError, RobotState
from pepper_driver.backends import BackendError
from pepper_driver.config import UnknownNameError
from pepper_driver.config.errors import ArgumentError
from pepper_driver.config.steps import MIN_DURATION
from pepper_driver.controller import GainError, TargetError, Tick
from pepper_driver.log import LogError, LogEvent, read_log
from pepper_driver.observer import Observation, shipped
from support.full_disk import limit_disk

LIGHT = "mujoco://?plant=integral"
"""On this plant a light touch moves the arm by degrees."""


def test_the_dozen_lines_of_the_readme() -> None:
    """A push is detected on the right joint and link, in the right direction, and the callback gets it."""
    received: list[Contact] = []
    pepper = Pepper(LIGHT)

    @pepper.on_contact(link="LBicep")
    def touched(contact: Contact) -> None:
        received.append(contact)

    with pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(3.0)
        pepper.push("LBicep", [0.0, 20.0, 0.0], point=[0.16, 0.0, 0.0], duration=1.0)
        pepper.run(2.0)
        truth = pepper.backend.plant.stiffness[pepper.config.joint_index("LShoulderRoll")]

    assert len(received) == 1
    contact = received[0]
    assert (contact.joint, contact.link, contact.direction) == ("LShoulderRoll", "LBicep", 1)
    assert contact.phase == "begin"
    assert 4.0 < contact.time < 4.6  # the ramp of the stiffness takes the first second
    ends = [c for c in pepper.contact_history if c.phase == "end" and c.id == contact.id]
    assert len(ends) == 1
    # The largest residual is the torque over the stiffness, less what friction holds.
    lever = 0.16 * np.cos(0.6 - 0.57)  # the force is along the world's y
    assert ends[0].intensity_deg == pytest.approx(np.degrees(20.0 * lever / truth), rel=0.35)


def test_hold_stops_the_motion_and_lets_it_go_on() -> None:
    def travel(*reflexes: Hold) -> tuple[float, float]:
        """Way of the reference while touched, and its end."""
        with Pepper(LIGHT, reflexes=list(reflexes)) as pepper:
            pepper.set_posture({"LShoulderRoll": 1.2}, stiffness=2.0)
            pepper.run(0.2)
            pepper.push("LBicep", [0.0, 25.0, 0.0], [0.16, 0.0, 0.0], 1.2, frame="link")
            pepper.run(0.7)
            index = pepper.config.joint_index("LShoulderRoll")
            before = pepper.controller.position[index]
            pepper.run(0.4)
            after = pepper.controller.position[index]
            pepper.run(6.0)
            return after - before, pepper.controller.position[index]

    moved_free, end_free = travel()
    moved_held, end_held = travel(Hold())
    assert abs(moved_held) < 0.5 * abs(moved_free)
    assert end_held == pytest.approx(end_free, abs=0.01) == pytest.approx(1.2, abs=0.01)


def test_the_log_holds_what_happened(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Pepper(f"{LIGHT}&seed=5", log=path) as pepper:
        pepper.push("LBicep", [0.0, 25.0, 0.0], [0.16, 0.0, 0.0], 0.8, frame="link")
        pepper.run(1.5)
        contacts = pepper.contact_history
        identity = pepper.backend.info.identity
    log = read_log(path)
    assert log.complete
    assert len(log) == round(1.5 / 0.012)
    assert log.contacts == list(contacts)
    assert len(contacts) >= 2
    assert log.metadata["identity"] == identity
    assert log.metadata["backend"] == f"{LIGHT}&seed=5"
    assert log.truth is not None
    assert np.abs(log.truth["contact_torque"]).max() > 3.0


def arrays(thing: object) -> Iterator[np.ndarray[Any, Any]]:
    """All arrays in a tick or an observation."""
    if isinstance(thing, np.ndarray):
        yield thing
    elif is_dataclass(thing):
        for field in fields(thing):
            yield from arrays(getattr(thing, field.name))


@pytest.mark.parametrize("observer", ["fusion", "paper", "momentum"])
def test_nothing_in_a_tick_is_changed_afterwards(observer: str) -> None:
    """The log and callbacks read ticks on threads of their own, later."""
    kept: list[tuple[np.ndarray[Any, Any], bytes]] = []

    def keep(tick: Tick, observation: Observation | None) -> None:
        kept.extend((array, array.tobytes()) for array in (*arrays(tick), *arrays(observation)))

    with Pepper(LIGHT, observer=observer, reflexes=[Hold()]) as pepper:
        pepper.controller.base_velocity.target = [0.1, 0.0, 0.2]
        pepper.set_posture({"LShoulderRoll": 0.8, "HeadYaw": 0.5})
        pepper.run(1.0, on_tick=keep)
        pepper.push("LBicep", [0.0, 25.0, 0.0], [0.16, 0.0, 0.0], 1.0, frame="link")
        pepper.run(2.0, on_tick=keep)
        assert pepper.contact_history
    assert len(kept) > 20 * 250
    assert all(array.tobytes() == before for array, before in kept)


def test_a_full_disk_does_not_disturb_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit_disk(monkeypatch, 30_000)
    pepper = Pepper("mujoco", observer=None, log=tmp_path / "run.mcap")
    pepper.start()
    pepper.run(2.0)
    assert pepper.state is RobotState.ACTIVE
    with pytest.raises(LogError, match="the disk is full"):
        pepper.stop()
    assert 0 < len(read_log(tmp_path / "run.mcap")) < 2.0 / 0.012


def test_a_stop_between_two_ticks_is_in_the_log(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Pepper("mujoco", observer=None, log=path) as pepper:
        pepper.run(0.12)
        pepper.emergency_stop()
        for _ in range(2):
            with pytest.raises(FaultError):
                pepper.run(0.12)
        time = pepper.time
    log = read_log(path)
    assert len(log) == 10
    assert log.events == [
        LogEvent(time=time, kind="fault", name="emergency stop", text="emergency stop")
    ]


def test_an_interrupted_run_leaves_a_log_that_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def interrupt_after_a_while() -> None:
        ticks = 0

        def count(*_: object) -> None:
            nonlocal ticks
            ticks += 1
            if ticks == 50:
                raise KeyboardInterrupt

        with Pepper("mujoco", log=path) as pepper:
            pepper.run(5.0, on_tick=count)

    with pytest.raises(KeyboardInterrupt):
        interrupt_after_a_while()
    log = read_log(path)
    assert log.complete
    assert len(log) == 50


def test_a_stop_before_the_first_start_makes_it_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    pepper = Pepper("mujoco", observer=None)
    pepper.emergency_stop("q was pressed")
    monkeypatch.setattr(pepper.backend, "activate", pytest.fail)
    with pytest.raises(FaultError, match="q was pressed"):
        pepper.start()
    monkeypatch.undo()
    with pepper:  # a new start
        pepper.run(0.1)
    pepper.emergency_stop("after a run")
    with pepper:
        pepper.run(0.1)


def test_emergency_stop_holds_and_stays() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        pepper.set_posture({"LShoulderRoll": 1.0})
        pepper.run(0.3)
        pepper.emergency_stop()
        with pytest.raises(FaultError, match="emergency stop"):
            pepper.run(1.0)
        assert pepper.state is RobotState.FAULT
        with pytest.raises(FaultError):
            pepper.run(0.1)


def test_it_can_be_entered_again() -> None:
    received: list[Contact] = []
    reflex = Hold()
    pepper = Pepper(LIGHT, observer="paper", reflexes=[reflex])
    pepper.on_contact()(received.append)
    for count in (1, 2):
        with pepper:
            assert pepper.contact_history == ()
            assert not reflex.active
            pepper.run(0.5)
            pepper.push("LBicep", [0.0, 25.0, 0.0], [0.16, 0.0, 0.0], 0.8, frame="link")
            pepper.run(0.6)
            assert reflex.active
        assert len(received) == count
        assert [contact.id for contact in pepper.contact_history if contact.phase == "begin"] == [1]


def test_wrong_postures_are_refused_and_change_nothing() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        before = pepper.target
        wrong: list[tuple[Any, type[Exception]]] = [
            ("Standing", UnknownNameError),
            ({"LShoulderRol": 0.2}, UnknownNameError),
            ({"LShoulderRoll": 5.0}, TargetError),
            ({"LShoulderRoll": float("nan")}, TargetError),
            ({"LShoulderRoll": "up"}, TargetError),
            (None, ArgumentError),
            (np.zeros(16), TargetError),
            (np.full(17, np.inf), TargetError),
        ]
        for posture, error in wrong:
            with pytest.raises(error):
                pepper.set_posture(posture)
            np.testing.assert_array_equal(pepper.target, before)
        wrong_numbers: list[Any] = [-1.0, 0.0, float("nan"), float("inf"), "a", [1.0]]
        for number in [*wrong_numbers, 1e5]:  # at 0 nothing would stop a joint
            with pytest.raises(GainError, match="stiffness"):
                pepper.set_posture("Stand", stiffness=number)
        for number in [*wrong_numbers, 0.9e-3, 3601.0]:
            with pytest.raises(TargetError, match="duration"):
                pepper.set_posture("Stand", duration=number)
        np.testing.assert_array_equal(pepper.target, before)


def test_a_duration_that_is_taken_is_no_fault_later() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        durations: tuple[Any, ...] = (MIN_DURATION, np.float32(0.5), 1)
        for duration in durations:
            pepper.set_posture({"HeadYaw": 0.1}, duration=duration)
            pepper.run(0.05)
        assert pepper.state is RobotState.ACTIVE


@pytest.mark.parametrize("seconds", ["a", None, float("nan"), float("inf"), -0.1])
def test_a_time_that_is_none_runs_nothing(seconds: Any) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        before = pepper.time
        with pytest.raises(TargetError, match="seconds"):
            pepper.run(seconds)
        assert pepper.time == before


def test_nothing_works_outside_the_block() -> None:
    pepper = Pepper("mujoco", observer=None)
    assert pepper.state is RobotState.INACTIVE
    with pytest.raises(BackendError, match="with Pepper"):
        pepper.run(1.0)
    with pytest.raises(BackendError, match="with Pepper"):
        pepper.set_posture("Stand")
    pepper.stop()


def test_unknown_names_are_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="paper"):
        Pepper("mujoco", observer="papr")
    pepper = Pepper("mujoco")
    with pytest.raises(UnknownNameError, match="LForeArm"):
        pepper.on_contact(link="LForearm")
    with pytest.raises(UnknownNameError, match="LShoulderRoll"):
        pepper.on_contact(joint="LShoulderRol")


def test_models_of_another_robot_are_refused(tmp_path: Path) -> None:
    text = shipped("affine")["nominal"].read_text()
    identity = Pepper("mujoco").backend.info.identity
    foreign = tmp_path / "foreign.json"
    foreign.write_text(text.replace(identity, "0123456789abcdef"))
    with pytest.raises(PepperError, match="another robot"):
        Pepper("mujoco", models=foreign)
    foreign.write_text(text[: len(text) // 2])
    with pytest.raises(PepperError, match=r"foreign\.json"):
        Pepper("mujoco", models=foreign)


def test_paths_may_be_text(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    models = str(shipped("cart")["nominal"])
    with Pepper("mujoco", observer="paper", models=models, log=str(path)) as pepper:
        pepper.run(0.1)
    assert read_log(path).complete


def test_a_robot_that_does_not_open_costs_no_earlier_log(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"an earlier log")
    pepper = Pepper("mujoco", observer=None, log=path)
    pepper.backend.open()  # taken already
    with pytest.raises(BackendError, match="already open"):
        pepper.start()
    assert path.read_bytes() == b"an earlier log"


def test_a_log_begins_when_it_is_requested(tmp_path: Path) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    with Pepper("mujoco", observer=None) as pepper:
        pepper.run(0.6)
        pepper.start_log(first)
        pepper.run(0.24)
        with pytest.raises(BackendError, match=r"logged already, to '.*first\.mcap'"):
            pepper.start_log(second)
    log = read_log(first)
    assert log.complete
    assert (len(log), log["missed"].max()) == (20, 0)
    assert not second.exists()
    with Pepper("mujoco", observer=None, log=second) as pepper:
        with pytest.raises(BackendError, match="logged already"):
            pepper.start_log(first)
        pepper.run(0.12)
    assert (len(read_log(first)), len(read_log(second))) == (20, 10)
    with pytest.raises(BackendError, match="not active"):
        pepper.start_log(first)


def test_an_unwritable_log_is_refused_before_anything_moves(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    pepper = Pepper("mujoco", observer=None, log=blocked / "run.mcap")
    with pytest.raises(PepperError, match="file"):
        pepper.start()
    assert pepper.state is RobotState.INACTIVE
    assert pepper.backend.open().tick == 0  # it was closed again
    pepper.stop()
