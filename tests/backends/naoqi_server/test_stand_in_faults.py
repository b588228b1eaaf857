"""The list of faults: what a command line may say, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi_server.faults import (
    FAULTS,
    InjectedFault,
    make_fault,
    parse_fault,
)
from pepper_driver.config import ConfigError, PepperError, UnknownNameError


@pytest.mark.parametrize(
    ("text", "name", "arguments", "seconds", "after"),
    [
        ("hang", "hang", {}, math.inf, 0.0),
        ("hang:2", "hang", {}, 2.0, 0.0),
        ("kill:seconds=1,after=5", "kill", {}, 1.0, 5.0),
        ("slow:0.02,DCM.setAlias", "slow", {"delay": 0.02, "calls": "DCM.setAlias"}, math.inf, 0.0),
        ("network:wired", "network", {"name": "wired"}, math.inf, 0.0),
        ("dropped", "dropped", {"fraction": 1.0}, math.inf, 0.0),
        ("error:DCM,text=a = b", "error", {"calls": "DCM", "text": "a = b"}, math.inf, 0.0),
        ("rollover:2", "rollover", {"in": 2.0}, math.inf, 0.0),
    ],
)
def test_a_command_line_says_it_all(
    text: str, name: str, arguments: dict[str, object], seconds: float, after: float
) -> None:
    expected = InjectedFault(name=name, arguments=arguments, seconds=seconds, after=after)  # type: ignore[arg-type]
    assert parse_fault(text) == expected


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("hangs:2", "did you mean hang"),
        ("", "possible: .*hang"),
        ("hang:-1", "seconds must be at least 0, got -1"),
        ("slow:soon", "delay must be a number, got 'soon'"),
        ("slow:nan", "delay must be a number"),
        ("dropped:1.5", "fraction must be from 0 to 1, got 1.5"),
        ("hang:secs=1", "did you mean seconds"),
        ("hang:seconds=1,seconds=2", "given twice"),
        ("hang:1,2,3", "no more than seconds, after"),
        ("rollover:seconds=2", "unknown argument 'seconds'.*possible: in"),
    ],
)
def test_what_makes_no_sense_is_refused(text: str, word: str) -> None:
    with pytest.raises(PepperError, match=word):
        parse_fault(text)


def test_values_of_other_types_are_refused() -> None:
    """From qi they come as anything."""
    with pytest.raises(ConfigError, match="joint must be a text, got 3"):
        make_fault("hot", {"joint": 3})
    with pytest.raises(ConfigError, match="celsius must be a number, got None"):
        make_fault("hot", {"celsius": None})
    with pytest.raises(UnknownNameError, match="did you mean hot"):
        make_fault("hott")
    assert make_fault("hot", {"celsius": 90}).arguments["celsius"] == 90.0


def test_each_fault_says_what_it_does_and_how_a_robot_comes_to_it() -> None:
    for name, kind in FAULTS.items():
        assert kind.effect, name
        assert kind.source, name
        assert set(kind.ranges) <= set(kind.arguments), name
        made = make_fault(name)
        assert made.arguments == dict(kind.arguments)


@given(st.sampled_from([*FAULTS, "hang"]), st.text(max_size=30))
def test_any_text_is_a_fault_or_one_line(name: str, rest: str) -> None:
    try:
        made = parse_fault(f"{name}:{rest}")
    except PepperError as error:
        assert name in str(error)
    else:
        assert made.seconds >= 0.0
        assert made.after >= 0.0
