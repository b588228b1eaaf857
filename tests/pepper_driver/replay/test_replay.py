"""Replays decide what was decided then, bit for bit; what differs is reported, and what is missing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Comply, FaultError, Hold, Pepper, Reflex, Retract, Soften, StopBase
from pepper_driver.backends import Measurement, NotConnectedError, make_backend
from pepper_driver.backends.fields import fields_of
from pepper_driver.backends.log_file import LogError
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.cli.app import run as pepper_command
from pepper_driver.config import PepperError, load_observer_settings, load_robot
from pepper_driver.config.loading import package_file
from pepper_driver.controller import Tick
from pepper_driver.log import LogWriter, read_log
from pepper_driver.loop import TickRecord
from pepper_driver.observer import Observation, Observer
from pepper_driver.observers import contact_observer
from pepper_driver.replay import Comparison, Replayed, compare, load_run, replay
from support.jitter import Jittery
from support.log_samples import same_bits

ROBOT = load_robot()
URI = "mujoco://?seed=3&plant=integral"


def reflexes() -> list[Reflex]:
    return [
        Hold(limb="head", release_delay=0.2),
        Retract(link="RBicep", release_delay=0.2, distance=0.2),
        Comply(joint="LShoulderRoll", gain=0.8, name="give way"),
        Soften(joint="RShoulderRoll", stiffness=0.6, release_delay=1.0),
    ]


def perform(pepper: Pepper) -> None:
    """Pushes that set off all of them."""
    pepper.set_posture({"LShoulderRoll": 0.6, "RShoulderRoll": -0.5, "LElbowRoll": -0.8})
    pepper.run(2.0)
    pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.6)
    pepper.set_posture({"LShoulderRoll": 0.5, "HeadYaw": 0.4}, duration=1.0)
    pepper.run(2.0)
    pepper.push("RBicep", [0, -25, 0], point=[0.16, 0, 0], duration=0.6)
    pepper.run(2.5)
    pepper.push("Head", [25, 0, 0], duration=0.6)
    pepper.set_posture({"LShoulderRoll": 0.9}, duration=1.0)
    pepper.run(1.5)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with Pepper(URI, log=path, reflexes=reflexes()) as pepper:
        perform(pepper)
    return path


def replayed(path: Path) -> tuple[Replayed, Comparison]:
    """As the command does it."""
    run = load_run(path)
    found = replay(run, run.observer(), run.reflexes())
    return found, compare(run, found)


# -- the same -------------------------------------------------------------------------------------------------------


def test_contacts_and_reflexes_are_found_bit_for_bit(log: Path) -> None:
    found, result = replayed(log)
    read = read_log(log)
    names = {event.name for event in read.events if event.kind == "reflex"}
    assert names == {"hold", "retract", "give way", "soften"}, "the run must be worth replaying"
    assert read["sent_stiffness"].min() < 0.9
    assert result.identical, result.differences
    assert [contact for _, contact in found.contacts] == read.contacts
    assert [event for _, event in found.events] == [e for e in read.events if e.kind == "reflex"]
    for name, values in found.values.items():
        assert same_bits(values, read[name]), name
    assert result.commands.compared > 600
    assert result.commands.differing == 0
    assert not result.notes
    figures = result.as_json()
    assert figures["contacts"]["both"] == figures["contacts"]["recorded"] >= 3
    assert figures["contacts"]["missed"] == figures["contacts"]["new"] == 0


def test_a_variant_is_replayed_with_the_models_it_was_recorded_with(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco://?plant=drift&draw=5", log=path) as pepper:
        pepper.set_posture({"LElbowRoll": -0.6})
        pepper.run(1.0)
        parents = pepper.backend.info.parents
    assert [parent.name for parent in parents] == ["drift-0", "nominal"]
    assert make_backend(f"replay://{path}").info.parents == parents
    caplog.clear()
    found, result = replayed(path)
    assert result.identical, result.differences
    assert np.isfinite(found.values["expected"][-1]).all()
    (record,) = caplog.records
    assert "uses the models of plant 'nominal'" in record.getMessage()
    path = edited(path, tmp_path / "b.mcap", parents=None)
    with pytest.raises(PepperError, match="no models come with the package for 'mujoco://"):
        load_run(path).observer()


def test_a_replay_can_be_repeated(log: Path) -> None:
    run = load_run(log)
    observer, reflexes = run.observer(), run.reflexes()
    first, second = (replay(run, observer, reflexes) for _ in range(2))
    assert first.contacts == second.contacts
    assert first.events == second.events


def test_recorded_reflexes_have_their_arguments(log: Path) -> None:
    made = {reflex.name: reflex for reflex in load_run(log).reflexes()}
    retract, comply = made["retract"], made["give way"]
    assert isinstance(retract, Retract)
    assert (retract.link, retract.distance, retract.release_delay) == ("RBicep", 0.2, 0.2)
    assert isinstance(comply, Comply)
    assert (comply.joint, comply.gain) == ("LShoulderRoll", 0.8)


def test_its_log_holds_the_recorded_ticks_and_replays_too(log: Path, tmp_path: Path) -> None:
    run, out = load_run(log), tmp_path / "again.mcap"
    replay(run, run.observer(), run.reflexes(), out=out)
    then, now = read_log(log), read_log(out)
    for name in then.fields:
        if name not in ("tick_end", "missed"):
            assert same_bits(now[name], then[name]), name
    assert now.contacts == then.contacts
    assert now.metadata["replay_of"] == "run.mcap"
    assert now.metadata["backend"] == URI
    assert replayed(out)[1].identical


def test_what_the_gate_changed_is_found_again_with_wheels_and_base(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper(URI, log=path, reflexes=[StopBase()]) as pepper:
        pepper.controller.base_velocity.target = [0.25, 0.1, 0.4]
        pepper.set_posture({"LShoulderRoll": 0.9})
        pepper.run(1.0)
        leap = pepper.controller.position
        leap[ROBOT.joint_index("LShoulderRoll")] += 0.05
        pepper.controller.override_state(leap)
        pepper.run(0.6)
        pepper.push("LBicep", [0, 40, 0], point=[0.16, 0, 0], duration=0.4)
        pepper.run(0.8)
    read = read_log(path)
    assert read["limited"].any()
    assert read["sent_wheel_speed"].any()
    found, result = replayed(path)
    assert found.events
    assert result.identical, result.differences
    assert result.commands.compared > 190


@pytest.fixture(scope="module")
def jittery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run over a network: a third of the samples comes late, so some come twice and others never."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    random = np.random.default_rng(5)
    late = random.choice([0, 0, 0, 0, 1, 1, 2, 4], 800)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.robot.make_backend", lambda uri, _: Jittery(uri, late))
        with Pepper(URI, log=path, reflexes=reflexes()) as pepper:
            perform(pepper)
    return path


def test_a_run_over_a_network_is_found_bit_for_bit(jittery: Path) -> None:
    """The command that a sample answers changes from tick to tick, samples repeat, and commands stay unmatched."""
    found, result = replayed(jittery)
    run = load_run(jittery)
    read = run.log
    assert len(set(read["response_delay"])) >= 4
    assert (np.diff(read["tick"]) == 0).sum() > 50
    assert len(read.unmatched["step"]) > 50
    assert {event.name for event in read.events if event.kind == "reflex"} >= {"retract", "soften"}
    assert result.identical, result.differences
    assert not result.notes
    assert result.commands.compared > len(read) - 10, "also those that no sample answers"
    assert [contact for _, contact in found.contacts] == read.contacts
    for name, values in found.values.items():
        assert same_bits(values, read[name]), name
    measured = run.backend.measurements
    assert [m.response_delay for m in measured] == read["response_delay"].tolist()
    assert [m.dropped_commands for m in measured] == read["dropped_commands"].tolist()


def test_the_error_of_a_late_sample_is_no_error_of_the_robot(jittery: Path, log: Path) -> None:
    """Pair each sample with its own command: the tracking error is that of a run without a network."""
    errors = [read["sent_position"] - read["position"] for read in map(read_log, (log, jittery))]
    still, late = (np.percentile(np.abs(error[:160]), 99.5) for error in errors)
    assert late < 1.2 * still


def test_a_run_over_a_network_replays_from_its_replay(jittery: Path, tmp_path: Path) -> None:
    run, out = load_run(jittery), tmp_path / "again.mcap"
    replay(run, run.observer(), run.reflexes(), out=out)
    then, now = run.log.unmatched, read_log(out).unmatched
    assert all(same_bits(now[name], then[name]) for name in then)
    assert replayed(out)[1].identical


@pytest.mark.parametrize("observer", ["paper", "momentum"])
def test_every_mode_is_found_again(observer: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper(URI, observer=observer, log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(0.5)
        pepper.push("LBicep", [0, 30, 0], point=[0.16, 0, 0], duration=0.5)
        pepper.run(0.7)
    found, result = replayed(path)
    assert result.identical, result.differences
    assert not found.reflexes
    assert found.observer is not None
    assert found.observer.startswith(observer)


def test_a_stopped_run_ends_as_then(tmp_path: Path) -> None:
    class Breaks(Hold):
        def begin(self, *_: object) -> None:
            raise KeyError("a mistake")

    path = tmp_path / "a.mcap"
    with (
        pytest.raises(FaultError),
        Pepper(URI, log=path, reflexes=[Breaks(joint="LShoulderRoll")]) as pepper,
    ):
        perform(pepper)
    run = load_run(path)
    with pytest.raises(
        PepperError, match=r"'breaks' is of the class .*Breaks of its program.*--reflexes"
    ):
        run.reflexes()
    found = replay(run, run.observer(), [Breaks(joint="LShoulderRoll")])
    assert found.fault is not None
    assert "KeyError" in found.fault.text
    result = compare(run, found)
    assert result.identical, result.differences
    assert any("stopped" in note for note in result.notes)
    without = compare(run, replay(run, run.observer()))
    (difference,) = without.differences
    assert re.fullmatch(
        r"stop of the robot: reflex .breaks. .*KeyError.*: recorded only", difference.text
    )


class Harmed(Jittery):
    """From a tick on all measurements are changed."""

    def __init__(self, uri: str, change: dict[str, Any]) -> None:
        super().__init__(uri, np.zeros(0, dtype=np.int_))
        self._change, self._ticks = change, 0

    def read(self) -> Measurement:
        self._ticks += 1
        measurement = super().read()
        return replace(measurement, **self._change) if self._ticks > 20 else measurement


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stiffness": np.zeros(17)}, "the stiffness of all joints was lowered"),
        (
            {"age": 0.2, "stale_reason": "no answer from RElbowYaw"},
            "200 ms old: no answer from RElbow",
        ),
    ],
)
def test_a_robot_that_was_not_well_stops_the_replay_as_well(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    """Why samples stayed away is in the recorded text alone."""
    path = tmp_path / "a.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.robot.make_backend", lambda uri, _: Harmed(uri, change))
        with Pepper(URI, log=path) as pepper, pytest.raises(FaultError, match=words):
            pepper.run(1.0)
    found, result = replayed(path)
    assert found.fault is not None
    assert result.identical, result.differences
    (difference,) = compare(load_run(path), replace(found, fault=None)).differences
    assert difference.text.startswith("stop of the robot")


def test_a_stop_by_hand_is_reported_and_is_no_difference(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper(URI, log=path) as pepper:
        pepper.run(0.3)
        pepper.emergency_stop()
        with pytest.raises(FaultError):
            pepper.run(0.3)
    found, result = replayed(path)
    assert found.fault is None
    assert result.identical, result.differences
    assert any("stopped at" in note for note in result.notes)


def unplugged(measurement: Measurement) -> Measurement:
    raise NotConnectedError("the connection was lost")


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        (lambda m: replace(m, commanded_by_others=("HeadYaw",)), FaultError, "HeadYaw"),
        (unplugged, NotConnectedError, "the connection was lost"),
    ],
)
def test_a_stop_that_no_measurement_shows_is_reported_and_is_no_difference(
    tmp_path: Path, fault: Fault, error: type[PepperError], words: str
) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mock", observer=None, log=path) as pepper:
        assert isinstance(pepper.backend, MockBackend)
        pepper.backend.faults[30] = fault
        with pytest.raises(error, match=words):
            pepper.run(1.0)
    found, result = replayed(path)
    assert found.fault is None
    assert result.identical, result.differences
    assert any("stopped at" in note and words in note for note in result.notes)


# -- not the same ---------------------------------------------------------------------------------------------------


def test_another_setting_is_reported(log: Path) -> None:
    run = load_run(log)
    settings = load_observer_settings()
    identities = run.backend.info.identities
    # as recorded
    observer = contact_observer("fusion", ROBOT, identities, None, settings)
    assert compare(run, replay(run, observer, run.reflexes())).identical
    limited = replace(settings, update_period=0.13)
    observer = contact_observer("fusion", ROBOT, identities, None, limited)
    result = compare(run, replay(run, observer, run.reflexes()))
    assert not result.identical
    first = result.differences[0]
    assert re.match(r"(update|end) of contact \d+ \(LShoulderRoll\): time 4\.|", first.text)
    assert first.time > 2.0
    figures = result.as_json()["contacts"]
    assert figures["both"] == figures["recorded"], "the contacts are the same, their updates not"


def test_a_changed_bit_of_a_measurement_is_reported(log: Path) -> None:
    """The comparison sees the last bit: here of one encoder in one tick, half a second before the first push."""
    run = load_run(log)
    joint = ROBOT.joint_index("LShoulderRoll")
    row = 120
    ticks = list(run.ticks)
    measurement = ticks[row].measurement
    position = measurement.position.copy()
    position[joint] = np.nextafter(position[joint], 9.0)
    ticks[row] = replace(ticks[row], measurement=replace(measurement, position=position))
    object.__setattr__(run, "ticks", tuple(ticks))
    result = compare(run, replay(run, run.observer(), run.reflexes()))
    assert not result.identical
    first = result.differences[0]
    assert first.time == pytest.approx(measurement.time, abs=0.1)
    # Thresholds of one joint depend on what others do: which one shows the bit first is the observer's affair.
    assert re.fullmatch(
        r"(residual|threshold|torque|torque_std) of \w+: \S+ in place of \S+", first.text
    )


@pytest.mark.parametrize("field", ["intensity_deg", "torque", "onset_time"])
def test_a_changed_bit_of_a_contact_is_reported(log: Path, field: str) -> None:
    run = load_run(log)
    place, contact = next((i, c) for i, c in enumerate(run.log.contacts) if c.torque is not None)
    value = np.nextafter(getattr(contact, field), 99.0)
    changes: dict[str, Any] = {field: float(value)}
    run.log.contacts[place] = replace(contact, **changes)
    result = compare(run, replay(run, run.observer(), run.reflexes()))
    (difference,) = result.differences
    assert f"contact {contact.id} (LShoulderRoll): {field} " in difference.text
    run.log.contacts[place] = contact
    run.log.contacts.pop()
    result = compare(run, replay(run, run.observer(), run.reflexes()))
    assert result.differences[0].text.endswith("found only")


def test_another_observer_is_compared_with_the_recorded_one(log: Path) -> None:
    run = load_run(log)
    result = compare(run, replay(run, run.observer("paper"), run.reflexes()))
    assert not result.identical
    figures = result.as_json()["contacts"]
    assert figures["recorded"] == figures["both"] + figures["missed"]
    assert figures["found"] == figures["both"] + figures["new"]
    assert figures["later"] >= 1, "the median of 11 is slower"
    for pair in result.contacts:
        assert (pair.later is None) == (pair.recorded is None or pair.found is None)


def test_other_reflexes_differ_in_events_and_stiffness(log: Path) -> None:
    run = load_run(log)
    result = compare(run, replay(run, run.observer(), ()))
    assert result.differences[0].text == ("begin of reflex give way: recorded only")
    assert any("command: stiffness of R" in d.text for d in result.differences)
    assert result.commands.largest["stiffness"] > 0.05
    assert result.as_json()["reflexes"]["missed"] == result.as_json()["reflexes"]["recorded"]


# -- logs that lack something ---------------------------------------------------------------------------------------


def test_a_log_that_is_cut_short_is_replayed_as_far_as_it_goes(log: Path, tmp_path: Path) -> None:
    whole, cut = log.read_bytes(), tmp_path / "cut.mcap"
    lengths = set()
    for fraction in np.linspace(0.45, 0.98, 12):
        cut.write_bytes(whole[: int(fraction * len(whole))])
        _, result = replayed(cut)
        assert result.identical, (fraction, result.differences)
        assert any("cut short" in note for note in result.notes)
        lengths.add(result.ticks)
    assert len(lengths) > 5


def test_a_contact_lost_with_the_end_of_the_log_is_no_difference(log: Path, tmp_path: Path) -> None:
    """A chunk may end between a row and the contacts of the same tick."""
    run, path = load_run(log), tmp_path / "a.mcap"
    contacts = replay(run, run.observer()).contacts
    last = contacts[0][0]
    with LogWriter(path, ROBOT, run.log.metadata, lossless=True) as writer:
        for row, tick in enumerate(run.ticks[: last + 1]):
            values: dict[str, Any] = {
                f.name: run.log[f.name][row] for f in fields_of("observation")
            }
            writer.append(TickRecord(tick=tick, observation=Observation(contacts=(), **values)))
    assert not replayed(path)[1].identical
    path.write_bytes(path.read_bytes()[:-8])
    assert replayed(path)[1].identical


def test_a_log_without_observer_is_observed_by_another(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper(URI, observer=None, log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(1.5)
        pepper.push("LBicep", [0, 30, 0], point=[0.16, 0, 0], duration=0.5)
        pepper.run(0.7)
    found, result = replayed(path)
    assert result.identical
    assert (found.observer, found.contacts, found.values) == (None, [], {})
    run = load_run(path)
    with pytest.raises(PepperError, match="had no observer"):
        run.observer(models=Path("a.json"))
    result = compare(run, replay(run, run.observer("fusion")))
    assert result.as_json()["contacts"]["new"] >= 1
    assert any("had no observer" in note for note in result.notes)


def test_a_log_from_the_middle_of_a_motion_is_observed_as_well(tmp_path: Path) -> None:
    """As ``pepper record`` may begin one: the gate then starts from a robot at rest, which it was not."""
    path = tmp_path / "a.mcap"
    with Pepper(URI, observer=None) as pepper:
        pepper.controller.base_velocity.target = [0.1, 0.0, 0.0]
        pepper.set_posture({"LShoulderRoll": 0.9}, duration=1.0)
        pepper.run(0.5)
        with LogWriter(path, ROBOT, pepper.run_metadata(), lossless=True) as log:
            pepper.run(
                0.7,
                on_tick=lambda tick, observation: log.append(
                    TickRecord(tick=tick, observation=observation)
                ),
            )
    run = load_run(path)
    assert not run.from_start
    result = compare(run, replay(run, run.observer("fusion")))
    assert result.ticks > 50
    assert result.identical, result.differences
    assert any("in the middle of a motion" in note for note in result.notes)


def edited(path: Path, to: Path, **metadata: str | None) -> Path:
    """The same log with other metadata; None takes a key out."""
    log, run = read_log(path), load_run(path)
    values = {k: v for k, v in {**log.metadata, **metadata}.items() if v is not None}
    with LogWriter(to, ROBOT, values, lossless=True) as writer:
        for tick in run.ticks[:50]:
            writer.append(TickRecord(tick=tick))
    return to


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        (
            {"observer_models_sha256": "00ff" * 16},
            "detected with the models 00ff00ff00ff.*--models",
        ),
        ({"identity": "its own", "parents": None}, "no models come with the package.*--models"),
        ({"parents": "{"}, "no 'parents' that can be read"),
        ({"parents": "[3]"}, "no 'parents' that can be read"),
        ({"parents": '[{"name": "nominal"}]'}, "no 'parents' that can be read"),
        ({"observer_mode": None}, "--observer"),
        ({"observer_settings": "{"}, "observer_settings"),
        ({"observer_settings": '{"tree": 3}'}, "observer_settings"),
        ({"reflexes": None}, "'reflexes'"),
        ({"reflexes": "3"}, "reflexes"),
        ({"reflexes": '[{"do": "juggle"}]'}, "unknown reflex 'juggle'"),
        ({"controller_settings": None}, "controller_settings"),
        ({"safety_settings": '{"following_error": -1}'}, "safety_settings"),
    ],
)
def test_what_is_missing_is_one_line(
    log: Path,
    tmp_path: Path,
    metadata: dict[str, str | None],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = edited(log, tmp_path / "a.mcap", **metadata)
    if "observer_mode" in metadata:
        path = edited(log, path, observer_mode=None, observer_name=None)
    assert pepper_command(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert re.search(message, error)
    assert error.count("\n") == 1


def test_an_observer_of_a_program_is_given_by_it(tmp_path: Path) -> None:
    class Mine(Observer):
        def step(self, tick: Tick) -> Observation:
            known = tick.sent.position - tick.measurement.position
            state = np.zeros(17, dtype=np.int8)
            values = dict.fromkeys(
                ("expected", "residual", "threshold", "torque", "torque_std"), known
            )
            return Observation(contacts=(), state=state, **values)

        def reset(self) -> None: ...

        def describe(self) -> str:
            return "mine"

    path = tmp_path / "a.mcap"
    with Pepper(URI, observer=Mine(), log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(0.5)
    run = load_run(path)
    with pytest.raises(PepperError, match=r"object of its program \(mine\)"):
        run.observer()
    assert compare(run, replay(run, Mine())).identical


def test_the_recording_is_not_overwritten(log: Path) -> None:
    run, before = load_run(log), log.read_bytes()
    with pytest.raises(PepperError, match="is the recording itself"):
        replay(run, None, out=log)
    assert log.read_bytes() == before
    with pytest.raises(LogError):
        load_run(log.with_name("nowhere.mcap"))


# -- the command ----------------------------------------------------------------------------------------------------


def test_the_command_says_that_all_is_the_same(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    assert pepper_command(["replay", str(log), "--json", str(figures)]) == 0
    shown = capsys.readouterr().out
    assert "identical bit for bit" in shown
    assert "RShoulderRoll" in shown
    assert "retract, hold" not in shown, "the order of priority"
    assert json.loads(figures.read_text())["identical"] is True


def test_the_command_reports_the_first_difference(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "observer.yaml"
    text = package_file("observer.yaml").read_text()
    settings.write_text(text.replace("collision_factor: 3.0", "collision_factor: 1.1"))
    assert text != settings.read_text()
    reflexes = tmp_path / "reflexes.yaml"
    reflexes.write_text("reflexes:\n- {on: {kind: collision}, do: stop_base}\n")
    arguments = ["--observer-settings", str(settings), "--reflexes", str(reflexes)]
    out = tmp_path / "new.mcap"
    assert pepper_command(["replay", str(log), *arguments, "--out", str(out)]) == 1
    shown = capsys.readouterr().out
    assert re.search(r"first difference, at \d+\.\d{3} s: ", shown)
    assert "now collision" in shown
    assert "stop_base" in shown
    assert read_log(out).contacts
    assert pepper_command(["replay", str(log), "--reflexes", "none"]) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("reflexes: 3", "line 1: key 'reflexes': a list"),
        ("reflexes: [hold]", "key 'reflexes': a list"),
        ("reflexes: []\nobserver: fusion", "line 2: unknown key 'observer'"),
        ("reflexes: [{do: retrat}]", "reflexes.0.do': unknown reflex 'retrat'.*retract"),
        ("reflexes: [{do: retract, distnace: 1}]", "unknown key 'reflexes.0.distnace'.*distance"),
        ("reflexes: [{do: hold, on: {link: LFoot}}]", "reflexes.0.on.link': unknown link"),
    ],
)
def test_wrong_reflexes_are_one_line(
    log: Path, tmp_path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "reflexes.yaml"
    file.write_text(text)
    assert pepper_command(["replay", str(log), "--reflexes", str(file)]) == 2
    assert re.search(message, capsys.readouterr().err)
