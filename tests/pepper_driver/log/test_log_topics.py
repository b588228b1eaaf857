"""Contacts, labels and events as JSON messages: what comes back, and what other tools can open."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from pepper_driver.callbacks.events import ReflexEvent, SensorEvent
from pepper_driver.log import Label, LogEvent, LogWriter, read_log
from pepper_driver.log.topics import CONTACTS, EVENTS, FORCES, LABELS, JsonTopic, TrueForce
from pepper_driver.loop import TickRecord
from support.log_samples import ROBOT, Samples, same_bits

TOPICS = (CONTACTS, LABELS, EVENTS, FORCES)
BEGUN = ReflexEvent(
    reflex="Hold",
    kind="hold",
    number=1,
    phase="begin",
    time=0.012,
    contact_id=3,
    joints=("LShoulderRoll", "LElbowRoll"),
    held_joints=("LElbowRoll",),
)
REFLEX = LogEvent(
    time=0.012,
    kind="reflex",
    name="Hold",
    phase="begin",
    contact_id=3,
    joints=("LShoulderRoll", "LElbowRoll"),
    held_joints=("LElbowRoll",),
)
FAULT = LogEvent(time=0.024, kind="fault", name="stale", text='the newest "sample" is old\n')
BUMP = SensorEvent(kind="bumper", name="bumper.Left", pressed=True, time=0.036)
PRESSED = LogEvent(time=0.036, kind="sensor", name="bumper.Left", phase="begin")


def foxglove_refuses(schema: dict[str, Any]) -> str:
    """Parts of a schema that the parser of Foxglove refuses: it knows fields of one plain type only."""
    if schema.get("type") != "object":
        return f"an object of type {schema.get('type')!r}"
    for name, field in schema["properties"].items():
        if "oneOf" in field:
            return f"{name}: oneOf"
        kind = field.get("type")
        if kind == "object":
            if problem := foxglove_refuses(field):
                return problem
        elif kind == "array":
            if field["items"]["type"] not in ("boolean", "string", "number", "integer"):
                return f"{name}: items"
        elif kind not in ("boolean", "string", "number", "integer"):
            return f"{name}: {kind!r}"
    return ""


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.topic)
def test_schema_opens_in_foxglove(topic: JsonTopic[Any]) -> None:
    schema = json.loads(topic.schema)
    assert not foxglove_refuses(schema)
    assert set(schema["required"]) < set(schema["properties"])


def valid(schema: dict[str, Any], message: dict[str, Any]) -> bool:
    """Return True for a message as its schema describes it, as far as these schemas go."""
    types: dict[str, Any] = {
        "string": str,
        "integer": int,
        "number": (int, float),
        "boolean": bool,
        "array": list,
    }
    return set(schema["required"]) <= set(message) and all(
        isinstance(value, types[schema["properties"][name]["type"]])
        and value in schema["properties"][name].get("enum", [value])
        for name, value in message.items()
    )


@pytest.mark.parametrize(
    ("topic", "item"),
    [
        *((CONTACTS, Samples(1).contact(number)) for number in range(6)),
        (LABELS, Label(time=1.0, phase="onset", source="key")),
        (LABELS, Label(time=1.0, phase="release", source="head", link="Head", joint="HeadYaw")),
        (LABELS, Label(time=1.0, phase="onset", source="key", link="Head", force=8.0)),
        *((FORCES, TrueForce.of(Samples(n).true_contact(), 1.0)) for n in range(6)),
        *((EVENTS, event) for event in (REFLEX, FAULT, PRESSED)),
    ],
)
def test_items_come_back_and_fit_their_schema(topic: JsonTopic[Any], item: object) -> None:
    message = topic.encode(item)
    assert topic.decode(message) == item
    assert valid(json.loads(topic.schema), json.loads(message))


def test_a_contact_of_an_earlier_version_has_no_force() -> None:
    contact = Samples(1).contact(4)
    assert contact.force is not None
    names = (
        "force",
        "force_covariance",
        "force_interval",
        "point",
        "point_covariance",
        "scale_known",
    )
    nothing: dict[str, Any] = {**dict.fromkeys(names), "limb_known": True}
    message = json.loads(CONTACTS.encode(contact))
    old = {name: value for name, value in message.items() if name not in nothing}
    assert CONTACTS.decode(json.dumps(old).encode()) == replace(contact, **nothing)


def test_a_label_of_an_earlier_version_has_no_force() -> None:
    message = b'{"time": 1.0, "phase": "onset", "source": "key", "link": "Head"}'
    assert LABELS.decode(message) == Label(time=1.0, phase="onset", source="key", link="Head")


@given(
    time=st.floats(),
    name=st.text(),
    phase=st.sampled_from(["begin", "end", None]),
    contact_id=st.none() | st.integers(0, 2**31),
    joints=st.lists(st.text(), max_size=3).map(tuple),
)
def test_any_event_comes_back(
    time: float, name: str, phase: Any, contact_id: Any, joints: Any
) -> None:
    event = LogEvent(
        time=time, kind="reflex", name=name, phase=phase, contact_id=contact_id, joints=joints
    )
    read = EVENTS.decode(EVENTS.encode(event))
    assert same_bits(read.time, time if math.isfinite(time) else math.nan)
    assert (read.name, read.phase, read.contact_id, read.joints) == (
        name,
        phase,
        contact_id,
        joints,
    )


def test_no_message_holds_what_a_browser_cannot_read(tmp_path: Path) -> None:
    contact = Samples(2).contact(4)
    object.__setattr__(contact, "torque", math.nan)
    object.__setattr__(contact, "intensity_deg", math.inf)
    message = CONTACTS.encode(contact)
    json.loads(message, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    read = CONTACTS.decode(message)
    assert read.torque is None
    assert math.isnan(read.intensity_deg)


def test_events_are_logged_with_their_tick_and_without(tmp_path: Path) -> None:
    samples = Samples(3)
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=samples.tick(1), events=[BEGUN]))
        log.note(FAULT)
        log.append(TickRecord(tick=samples.tick(3), events=(BUMP,), missed=2, tick_end=0.004))
        log.append(TickRecord(tick=samples.tick(4), missed=2))
    read = read_log(tmp_path / "a.mcap")
    assert read.events == [REFLEX, FAULT, PRESSED]
    assert read["tick"].tolist() == [1, 3, 4]
    assert read["missed"].tolist() == [0, 2, 2]
    assert same_bits(read["tick_end"], np.array([np.nan, 0.004, np.nan]))
    with (tmp_path / "a.mcap").open("rb") as stream:
        stamps = [m.log_time for _, c, m in make_reader(stream).iter_messages(["/event"])]
    assert stamps == [12_000_000, 24_000_000, 36_000_000]


def test_several_commands_may_be_left_unanswered(tmp_path: Path) -> None:
    samples = Samples(8)
    tick = samples.tick(0)
    sent = [(3, samples.sent()), (2, samples.sent())]
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        for answers in (3, None, 4, 1):
            measurement = replace(tick.measurement, response_delay=answers)
            late = sent if answers == 1 else ()
            log.append(TickRecord(tick=replace(tick, measurement=measurement), unmatched=late))
    read = read_log(tmp_path / "a.mcap")
    assert read["step"].tolist() == [0, 1, 2, 3]
    assert read["response_delay"].tolist() == [3, -1, 4, 1]
    assert read.unmatched["step"].tolist() == [0, 1], "that of step 2 is answered in step 3"
    for row, (_, one) in enumerate(sent):
        assert same_bits(read.unmatched["sent_position"][row], one.sent.position)


def test_a_row_that_is_none_keeps_its_events(tmp_path: Path) -> None:
    samples = Samples(4)
    bad = samples.tick(1)
    object.__setattr__(bad.measurement, "position", np.zeros(3))
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=bad, events=[BEGUN]))
    assert log.dropped == 1
    read = read_log(tmp_path / "a.mcap")
    assert (len(read), read.events) == (0, [REFLEX])


def test_another_decoder_reads_every_row(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder")
    samples = Samples(5)
    tick, observation, truth = samples.tick(7), samples.observation(), samples.truth()
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=tick, observation=observation, truth=truth, missed=3))
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        read = {c.topic: m for _, c, _, m in reader.iter_decoded_messages(["/tick", "/truth"])}
    row = read["/tick"]
    assert (row.time, row.tick, row.missed) == (0.084, 7, 3)
    assert same_bits(np.array(row.position), tick.measurement.position)
    assert same_bits(np.array(row.limited), tick.limited)
    assert list(row.state) == observation.state.tolist()
    assert same_bits(np.array(read["/truth"].wheel_load), truth.wheel_load)
    assert same_bits(np.array(read["/truth"].saturated), truth.saturated)
