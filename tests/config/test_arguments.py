"""Arguments of users: what is a number, an array, a path; and calls that do not fit their signature."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from math import inf, nan
from pathlib import Path
from typing import Any, TypedDict, Unpack
from typing import Unpack as Each

import numpy as np
import pytest

from pepper_driver.config import ConfigError, PepperError, RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.arguments import as_path, checked_arguments, is_number, real_array
from pepper_driver.config.errors import ArgumentError, printable, reason, shown


@pytest.mark.parametrize(
    "value", [0, -3, 1.5, nan, inf, np.float32(1), np.int64(2), Fraction(1, 2), 10**30]
)
def test_a_real_number_is_one(value: object) -> None:
    assert is_number(value)


@pytest.mark.parametrize(
    "value",
    [True, np.True_, "1", None, 1j, [1], np.array(1.0), Decimal(1), b"1", object(), 10**400],
)
def test_nothing_else_is_a_number(value: object) -> None:
    assert not is_number(value)


@pytest.mark.parametrize(
    "value", [[1, 2.5], (1, 2), np.arange(3), np.zeros((2, 2), np.float32), 3, [], [[1, 2], [3, 4]]]
)
def test_numbers_become_a_new_array(value: Any) -> None:
    array = real_array(value)
    assert array is not None
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, value)
    assert not np.shares_memory(array, np.asarray(value))


@pytest.mark.parametrize(
    "value",
    [
        True,
        [True, 1.0],
        [[1.0], [True]],
        "1",
        ["1", "2"],
        None,
        [None, 1.0],
        [1j],
        [[1], [1, 2]],
        {"x": 1},
        np.zeros(3, dtype=object),
        np.zeros(3, dtype=bool),
        np.zeros(3, dtype="datetime64[s]"),
        b"abc",
        object(),
    ],
)
def test_nothing_else_becomes_an_array(value: object) -> None:
    assert real_array(value) is None


def test_a_path_is_a_text_or_a_path(tmp_path: Path) -> None:
    assert as_path("log", "run.mcap") == Path("run.mcap")
    assert as_path("log", tmp_path) == tmp_path
    for wrong in ("", "a\0b", 3, None, b"run.mcap", True, ["x"]):
        with pytest.raises(ArgumentError, match="log must be the path of a file, got") as caught:
            as_path("log", wrong)
        assert isinstance(caught.value, PepperError)
        assert isinstance(caught.value, TypeError)


class Selector(TypedDict, total=False):
    link: str
    joint: str


@checked_arguments
def sample(
    count: int,
    robot: RobotConfig | None = None,
    *,
    fast: bool = False,
    until: Callable[[], bool] | None = None,
    callback: Callable[[int, int], object] = max,
    where: Path | str | None = None,
    texts: Mapping[str, str] | None = None,
    **selector: Unpack[Selector],
) -> int:
    """A function as public ones are."""
    if count < 0:
        raise TypeError("of the function itself")
    return count


def test_calls_that_fit_go_through() -> None:
    robot = load_robot()
    assert sample(1) == sample(count=1) == 1
    assert sample(2, robot, fast=True, until=lambda: True, callback=lambda a, b: None) == 2
    assert sample(3, None, where="x", texts={"a": "b"}, link="Head") == 3
    assert sample(4, fast=np.bool_(True), where=Path("x"), callback=print) == 4  # type: ignore[arg-type]
    assert sample.__name__ == "sample"
    assert sample.__doc__


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((), {}, "sample: missing a required argument: 'count'"),
        ((1, None, True), {}, "sample: too many arguments without a name (possible: count,"),
        ((1,), {"count": 2}, "sample: multiple values for argument 'count'"),
        ((1,), {"fst": True}, "sample: unknown argument 'fst' (did you mean fast?; possible:"),
        ((1,), {"lnk": "Head"}, "sample: unknown argument 'lnk' (did you mean link?"),
        ((1, 3), {}, "sample: robot must be a RobotConfig, got 3"),
        ((1,), {"robot": RobotConfig}, "robot must be a RobotConfig, got the class RobotConfig"),
        ((1,), {"fast": 1}, "sample: fast must be True or False, got 1"),
        ((1,), {"fast": None}, "sample: fast must be True or False, got None"),
        ((1,), {"until": True}, "until must be a function without arguments, got True"),
        ((1,), {"until": abs}, "until must be a function without arguments, got the function abs"),
        (
            (1,),
            {"callback": lambda a: a},
            "callback must be a function of 2 arguments, got the function",
        ),
        ((1,), {"where": 3}, "sample: where must be a path or a text, got 3"),
        ((1,), {"texts": [1]}, "sample: texts must be a mapping, got [1]"),
    ],
)
def test_calls_that_do_not_fit_are_one_line(
    arguments: tuple[Any, ...], keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(ArgumentError) as caught:
        sample(*arguments, **keywords)
    assert message in str(caught.value)


@checked_arguments
def free(count: int, **others: Any) -> int:
    """A function that takes any name."""
    if count < 0:
        raise TypeError("of the function itself")
    return len(others)


@checked_arguments
def typed(count: int, **others: int | str) -> int:
    """A function that takes any name, with values of some types."""
    return free(count, **others)


def test_plain_keywords_are_free() -> None:
    assert free(1, link="Head", lnk="Head") == typed(1, link="Head", lnk=3) == 2
    with pytest.raises(TypeError, match="of the function itself") as caught:
        free(-1, lnk="Head")
    assert not isinstance(caught.value, PepperError)
    with pytest.raises(ArgumentError, match="typed: missing a required argument: 'count'"):
        typed(lnk=3)  # type: ignore[call-arg]


class Wider(Selector):
    limb: str


@checked_arguments
def renamed(**selector: Each[Wider]) -> int:
    """A function whose ``Unpack`` was imported under another name."""
    return len(selector)


@checked_arguments
def misleading(**Unpack: Any) -> int:
    """A function that has the word, and takes any name."""
    return len(Unpack)


def test_unpacked_keywords_are_known_by_their_type() -> None:
    assert renamed(link="Head", limb="head") == 2
    with pytest.raises(ArgumentError, match=r"unknown argument 'lmb' \(did you mean limb\?"):
        renamed(lmb="head")  # type: ignore[call-arg]
    assert misleading(lmb="head") == 1


def test_a_type_error_of_the_function_stays_what_it_is() -> None:
    with pytest.raises(TypeError, match="of the function itself") as caught:
        sample(-1)
    assert not isinstance(caught.value, PepperError)


@checked_arguments
class Plain:
    def __init__(self, robot: RobotConfig, *, fast: bool = False) -> None:
        self.robot = robot


@checked_arguments
@dataclass(kw_only=True)
class Data:
    robot: RobotConfig | None = None
    fast: bool = False


@pytest.mark.parametrize("cls", [Plain, Data])
def test_a_class_checks_what_it_is_made_of(cls: Any) -> None:
    assert cls(robot=load_robot()).robot is load_robot()
    with pytest.raises(ArgumentError, match=f"{cls.__name__}: robot must be a RobotConfig, got 3"):
        cls(robot=3)
    with pytest.raises(ArgumentError, match=f"{cls.__name__}: fast must be True or False"):
        cls(robot=load_robot(), fast="no")
    with pytest.raises(ArgumentError, match=f"{cls.__name__}: unknown argument 'robt'"):
        cls(robt=load_robot())


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (3, "3"),
        ("x", "'x'"),
        ("a\nb", "'a\\nb'"),
        ("x" * 200, f"'{'x' * 80}'..."),
        (RobotConfig, "the class RobotConfig, not an object of it"),
        (len, "the function len"),
        ([0] * 100, "a list"),
        (object(), "an object"),
        (np.zeros(3), "array([0., 0., 0.])"),
        (np.zeros((40, 3)), "an array (40, 3) of float64"),
    ],
)
def test_a_wrong_value_is_shown_short(value: object, text: str) -> None:
    assert shown(value) == text


def test_a_message_is_one_line_whatever_is_in_it() -> None:
    assert str(ConfigError("a\nb\tc\x1b[31m\0\udc80é")) == "a\\nb\\tc\\x1b[31m\\x00\\udc80é"
    assert printable("plain") == "plain"
    assert "\n" not in str(UnknownNameError("joint", "a\nb", ["HeadYaw"]))


def test_many_names_are_listed_as_far_as_they_can_be_read() -> None:
    names = [f"name-{number:03d}" for number in range(200)]
    error = UnknownNameError("thing", "qqq", names)
    assert "name-024 and 175 more)" in str(error)
    assert error.choices == tuple(names)
    long = [f"{'x' * 60}-{number:03d}" for number in range(30)]
    assert len(str(UnknownNameError("thing", "qqq", long))) < 500


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (errno.ENOENT, "there is no such file"),
        (errno.EISDIR, "it is a folder"),
        (errno.EACCES, "no permission"),
        (errno.ENOSPC, "the disk is full"),
        (errno.EXDEV, "Invalid cross-device link"),
    ],
)
def test_why_a_file_cannot_be_read(number: int, text: str) -> None:
    error = OSError(number, "Invalid cross-device link", "some/path")
    assert reason(error) == text


def test_why_other_files_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UnicodeDecodeError) as caught:
        b"abc\xe9".decode()
    assert reason(caught.value) == "not UTF-8 text, at byte 3"
    with pytest.raises(ValueError, match="null") as other:
        (tmp_path / "a\0b").read_text()
    assert reason(other.value) == "no file can have this name"
    assert reason(ValueError()) == "ValueError"
