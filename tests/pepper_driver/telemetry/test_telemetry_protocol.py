"""Messages of the stream: whole whatever pieces they come in; anything else is refused."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.telemetry.protocol import (
    MAX_MESSAGE,
    Kind,
    Message,
    MessageBuffer,
    TelemetryError,
    pack,
    pack_json,
)

MESSAGES = st.lists(st.tuples(st.sampled_from(Kind), st.binary(max_size=50)), max_size=8)


@given(MESSAGES, st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_messages_are_whole_whatever_pieces_they_come_in(
    messages: list[tuple[Kind, bytes]], sizes: list[int]
) -> None:
    data = b"".join(pack(*message) for message in messages)
    buffer = MessageBuffer()
    found: list[Message] = []
    while data:
        size = sizes[len(found) % len(sizes)]
        piece, data = data[:size], data[size:]
        found += list(buffer.feed(piece))
    assert found == messages


@given(st.binary(max_size=200))
def test_bytes_of_others_are_refused_or_wait(data: bytes) -> None:
    """Nothing but a TelemetryError comes out, and no message is longer than what came."""
    try:
        found = list(MessageBuffer().feed(data))
    except TelemetryError:
        return
    assert sum(len(message.data) + 5 for message in found) <= len(data)


def test_a_message_too_long_is_refused_before_it_has_come() -> None:
    head = (MAX_MESSAGE + 1).to_bytes(4, "little") + bytes([Kind.TICK])
    with pytest.raises(TelemetryError):
        list(MessageBuffer().feed(head))


def test_json_is_an_object() -> None:
    (message,) = MessageBuffer().feed(pack_json(Kind.REQUEST, do="stop", number=3))
    assert message.json == {"do": "stop", "number": 3}
    (message,) = MessageBuffer().feed(pack(Kind.REQUEST, json.dumps([1]).encode()))
    with pytest.raises(ValueError, match="object"):
        _ = message.json
