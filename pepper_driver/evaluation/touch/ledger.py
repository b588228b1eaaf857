"""Ledger of the test split: each look at it is a line that is written when the look begins, and completed at its end.

Results on robots on which constants were chosen say nothing. So a look is taken only from a commit that
anyone can go back to, and after a look that led to a change the next hundred of draws is used.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TypeVar

from pepper_driver.config import PepperError, load_observer_settings
from pepper_driver.config.cluster import sources_hash
from pepper_driver.config.errors import reason
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.file_lock import lock_file
from pepper_driver.config.files import content_hash, make_folder, write_bytes
from pepper_driver.config.population import DEVELOPMENT_DRAWS, parse_draws
from pepper_driver.evaluation.touch.commit import versions_of, work_tree
from pepper_driver.evaluation.touch.n90 import MAX_FORCE

FIRST_DRAW, ROBOTS, HUNDRED = DEVELOPMENT_DRAWS, 20, 100
"""Draw of the first look's first robot; robots of a look; from one look's draws to those of the next."""

T = TypeVar("T")

_APART = (
    *(f"{name}/*" for name in ("bench", "callbacks", "cli", "doctor")),
    *(f"{name}/*" for name in ("first_hour", "rendering", "replay", "testing", "viewer")),
    *(f"backends/{name}/*" for name in ("naoqi", "naoqi_server")),
    *(f"evaluation/{name}.py" for name in ("figures", "report", "results")),
    *(f"evaluation/touch/{name}.py" for name in ("bundles", "comparison", "kinds", "map", "n90")),
    *(
        f"evaluation/touch/{name}.py"
        for name in ("page", "recall", "report", "summary", "summary_data")
    ),
    "config/evaluation_baselines.yaml",
    "config/observer.yaml",
    "config/touch_suites.yaml",
)
"""Files that no record of the test split depends on, and those that ``constants`` and ``suites`` cover."""


class LedgerError(PepperError, ValueError):
    """The ledger is damaged, or does not allow this look."""


# -- hashes -----------------------------------------------------------------------------------------------------------


def code_hash() -> str:
    """Return the hash of the files of this package that results depend on, other than settings of the observers."""
    return sources_hash(_APART)


def constants_hash() -> str:
    """Return the hash of the settings of the observer and of the factors of the baselines.

    Raises:
        ConfigError: One of these files is wrong.
    """
    baselines = load_evaluation_baselines()
    return content_hash([asdict(load_observer_settings()), baselines.version, baselines.factors])


# -- lines ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class MainResults:
    """Main results of a look; None where one is not available.

    Attributes:
        false_contacts: Of the takes in which no one touches the robot.
        hours: In which they could have come [h].
        n90_standing_nominal, n90_standing_integral: N90 of the hand of a standing robot, by board law [N]; infinite
            where it is beyond MAX_FORCE.
        n90_moving_nominal, n90_moving_integral: The same of a moving robot.
        delay_ms: Median delay of the alarm [ms].
    """

    false_contacts: int | None = None
    hours: float | None = None
    n90_standing_nominal: float | None = None
    n90_standing_integral: float | None = None
    n90_moving_nominal: float | None = None
    n90_moving_integral: float | None = None
    delay_ms: float | None = None

    @property
    def false_per_hour(self) -> float | None:
        """Rate of false contacts [1/h]."""
        if self.false_contacts is None or not self.hours:
            return None
        return self.false_contacts / self.hours


State = Literal["begun", "complete"]


@dataclass(frozen=True, kw_only=True)
class Look:
    """One line of the ledger.

    Attributes:
        look: Number, from 1.
        begun, ended: Times in UTC; ``ended`` is None until it is complete.
        commit: From which it is taken, whole hash.
        code, constants, suites: Hashes of them.
        draws: Of its robots, as :func:`parse_draws` takes them.
        state: ``begun`` until all robots are done.
        robots_done, robots: Those that are done, and all.
        results: Main results.
        note: Reason for the look, in one line.
    """

    look: int
    begun: datetime
    ended: datetime | None = None
    commit: str
    code: str
    constants: str
    suites: str
    draws: str
    state: State = "begun"
    robots_done: int = 0
    robots: int
    results: MainResults = field(default_factory=MainResults)
    note: str = ""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Draws of its robots."""
        return parse_draws(self.draws)


COLUMNS = (
    "look",
    "begun",
    "ended",
    "commit",
    "code",
    "constants",
    "suites",
    "draws",
    "state",
    "robots_done",
    "robots",
    "false_contacts",
    "hours",
    "false_per_hour",
    "n90_standing_nominal",
    "n90_standing_integral",
    "n90_moving_nominal",
    "n90_moving_integral",
    "delay_ms",
    "note",
)


def read_ledger(path: Path) -> tuple[Look, ...]:
    """Read the looks so far; none where there is no such file yet.

    Raises:
        LedgerError: The file cannot be read or a line is damaged; the message names the line.
    """
    return tuple(look for _, look in _read(path))


def as_rows(looks: Sequence[Look]) -> list[dict[str, str]]:
    """Return looks as rows of text, by column."""
    return [dict(zip(COLUMNS, next(csv.reader([_line(look)])), strict=True)) for look in looks]


def look_folder(path: Path, look: int) -> Path:
    """Return the folder for the results of a look, next to the ledger ``path``."""
    return path.parent / f"look-{look}"


def _read(path: Path) -> list[tuple[str, Look]]:
    """Return the lines behind the header, as they stand, with their content."""
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        raise LedgerError(f"{path}: cannot be read ({reason(error)})") from error
    return _lines(text, str(path))


def _lines(text: str, source: str) -> list[tuple[str, Look]]:
    lines = text.removesuffix("\n").split("\n")
    if lines[0].rstrip("\r") != ",".join(COLUMNS):
        raise LedgerError(f"{source} line 1: not the columns of a ledger; {_CURE}")
    found: list[tuple[str, Look]] = []
    for number, line in enumerate(lines[1:], 2):
        try:
            look = _parse(line.rstrip("\r"))
            if look.look != len(found) + 1:
                raise ValueError(f"look {look.look} where look {len(found) + 1} is due")
        except (ValueError, csv.Error) as error:
            raise LedgerError(f"{source} line {number}: damaged ({error}); {_CURE}") from error
        found.append((line, look))
    return found


_CURE = "restore the file from the repository, it is never repaired"


def _parse(line: str) -> Look:
    rows = list(csv.reader([line], strict=True))
    if len(rows) != 1 or len(rows[0]) != len(COLUMNS):
        raise ValueError(f"{len(COLUMNS)} values are due")
    cells = dict(zip(COLUMNS, rows[0], strict=True))
    results = MainResults(
        false_contacts=_optional(cells, "false_contacts", _count),
        **{name: _optional(cells, name, _reader(name)) for name in _NUMBERS},
    )
    if cells["state"] not in ("begun", "complete"):
        raise ValueError(f"'state' is {cells['state']!r}")
    state: State = "complete" if cells["state"] == "complete" else "begun"
    look = Look(
        look=_value(cells, "look", _count),
        begun=_value(cells, "begun", _time),
        ended=_optional(cells, "ended", _time),
        **{name: _value(cells, name, _word) for name in ("commit", "code", "constants", "suites")},
        draws=_value(cells, "draws", _draws),
        state=state,
        robots_done=_value(cells, "robots_done", _count),
        robots=_value(cells, "robots", _count),
        results=results,
        note=cells["note"],
    )
    if (look.ended is None) == (state == "complete"):
        raise ValueError("'ended' and 'state' contradict each other")
    if look.robots_done > look.robots or look.robots != len(look.numbers):
        raise ValueError("'robots' does not fit the draws, or fewer than are done")
    if cells["false_per_hour"] != _cell(results.false_per_hour):
        raise ValueError("'false_per_hour' is not false contacts over hours")
    return look


_NUMBERS = tuple(f.name for f in fields(MainResults) if f.name != "false_contacts")


def _value(cells: dict[str, str], name: str, read: Callable[[str], T]) -> T:
    try:
        return read(cells[name])
    except ValueError as error:
        raise ValueError(f"'{name}' is {cells[name][:40]!r}") from error


def _optional(cells: dict[str, str], name: str, read: Callable[[str], T]) -> T | None:
    return _value(cells, name, read) if cells[name] else None


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise ValueError(text)
    return int(text)


def _reader(name: str) -> Callable[[str], float]:
    return _force if name.startswith("n90") else _number


def _force(text: str) -> float:
    return math.inf if text == _BEYOND else _number(text)


def _number(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise ValueError(text)
    return value


def _time(text: str) -> datetime:
    time = datetime.fromisoformat(text)
    if time.tzinfo is None:
        raise ValueError(text)
    return time


def _word(text: str) -> str:
    if not (text and text.isascii() and text.isalnum()):
        raise ValueError(text)
    return text


def _draws(text: str) -> str:
    parse_draws(text)
    return text


_BEYOND = f">{MAX_FORCE:g}"


def _line(look: Look) -> str:
    """Return the line of a look, without its end."""
    values = {f.name: getattr(look, f.name) for f in fields(look)}
    results = {f.name: getattr(look.results, f.name) for f in fields(MainResults)}
    values |= {**results, "false_per_hour": look.results.false_per_hour}
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(_cell(values[name]) for name in COLUMNS)
    line = text.getvalue()
    if not line.isprintable():
        raise LedgerError("a note of the ledger is one line without control characters")
    try:
        kept = _parse(line) == look
    except ValueError as error:
        raise LedgerError(f"this is no line of a ledger, {error}: {line}") from error
    if not kept:
        raise LedgerError(f"this is no line of a ledger: {line}")
    return line


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="seconds")
    if isinstance(value, float):
        return _BEYOND if value == math.inf else f"{value:.4g}"
    return str(value)


def _rounded(results: MainResults) -> MainResults:
    """Return results with the digits that the ledger has."""
    rounded: dict[str, Any] = {}
    for name in _NUMBERS:
        value = getattr(results, name)
        rounded[name] = value if value in (None, math.inf) else float(f"{value:.4g}")
    return replace(results, **rounded)


# -- looks ------------------------------------------------------------------------------------------------------------


def has_changed(look: Look, *, code: str, constants: str, suites: str) -> bool:
    """Return True if code, constants or suites are not those of a look."""
    return (look.code, look.constants, look.suites) != (code, constants, suites)


def next_draws(
    ledger: Sequence[Look], changed: bool, *, give_up: bool = False, path: Path | None = None
) -> tuple[int, ...]:
    """Return the draws that the next look is at; those of an unfinished look where it is to be resumed.

    Args:
        ledger: Looks so far.
        changed: Whether anything has changed since the last of them.
        give_up: True to give up a last look that is unfinished. Its draws may have been seen: they are not used again.
        path: Of the ledger, for the message.

    Raises:
        LedgerError: Nothing has changed since the last look, which is complete; or that one is unfinished, and what it
            looked at has changed.
    """
    if not ledger:
        return tuple(range(FIRST_DRAW, FIRST_DRAW + ROBOTS))
    last = ledger[-1]
    if not changed and last.state == "complete":
        where = "" if path is None else f" and {look_folder(path, last.look)}"
        raise LedgerError(
            f"this was already looked at on {last.begun.date()} (look {last.look}, draws {last.draws}): its results "
            f"are in that line of the ledger{where}; 'pepper evaluate --split test --last-look' shows them"
        )
    if last.state == "begun" and not give_up:
        if not changed:
            return last.numbers
        raise LedgerError(
            f"look {last.look} has begun on {last.begun.date()} and is unfinished ({last.robots_done} of {last.robots} "
            f"robots), and code, constants or suites have changed since: undo that to resume it (it is of commit "
            f"{last.commit[:12]}), or give it up ('--give-up'), after which its draws are not used again"
        )
    used = max(draw for look in ledger for draw in look.numbers)
    first = FIRST_DRAW + ((used - FIRST_DRAW) // HUNDRED + 1) * HUNDRED
    return tuple(range(first, first + ROBOTS))


def begin_look(
    path: Path,
    *,
    commit: str,
    code: str,
    constants: str,
    suites: str,
    note: str = "",
    give_up: bool = False,
    now: datetime | None = None,
) -> Look:
    """Append a line for a look that begins now; an unfinished look of the same code is returned as it is.

    :func:`check_clean` and :func:`check_whole` come first. Where the look returned is of another commit (of the same
    code), that commit must pass :func:`check_resumed`.

    Args:
        path: The ledger; it is made with the first look.
        commit: HEAD, whole hash.
        code: Hash of the code, from :func:`code_hash`.
        constants: Hash of the settings, from :func:`constants_hash`.
        suites: Hash of the suites.
        note: Reason for the look, in one line.
        give_up: As of :func:`next_draws`.
        now: Its time; None for the present.

    Raises:
        LedgerError: The ledger is damaged, or does not allow a look; see :func:`next_draws`.
        InUseError: Another run writes it.
        OutputError: It cannot be written.
    """
    make_folder(path.parent)
    with lock_file(path):
        ledger = read_ledger(path)
        changed = bool(ledger) and has_changed(
            ledger[-1], code=code, constants=constants, suites=suites
        )
        draws = next_draws(ledger, changed, give_up=give_up, path=path)
        if ledger and ledger[-1].state == "begun" and ledger[-1].numbers == draws:
            return ledger[-1]
        look = Look(
            look=len(ledger) + 1,
            begun=_seconds(now),
            commit=commit,
            code=code,
            constants=constants,
            suites=suites,
            draws=f"{draws[0]}-{draws[-1]}",
            robots=len(draws),
            note=note,
        )
        _write(path, [*(line for line, _ in _read(path)), _line(look)])
    return look


def update_look(path: Path, look: int, *, robots_done: int) -> Look:
    """Rewrite the line of a look that goes on, and no other.

    Raises:
        LedgerError: The ledger is damaged, or this look is not in it or complete.
        InUseError: Another run writes it.
        OutputError: It cannot be written.
    """
    return _rewrite(path, look, lambda before: replace(before, robots_done=robots_done))


def complete_look(
    path: Path,
    look: int,
    results: MainResults,
    *,
    note: str | None = None,
    now: datetime | None = None,
) -> Look:
    """Complete the line of a look of which all robots are done, also those that failed; no other line is changed.

    Args:
        path: The ledger.
        look: Its number.
        results: Main results; the ledger keeps four digits.
        note: In place of the present one; None to leave that.
        now: Time of its end; None for the present.

    Raises:
        LedgerError: As :func:`update_look`.
        InUseError: Another run writes it.
        OutputError: It cannot be written.
    """

    def complete(before: Look) -> Look:
        return replace(
            before,
            state="complete",
            ended=_seconds(now),
            robots_done=before.robots,
            results=_rounded(results),
            note=before.note if note is None else note,
        )

    return _rewrite(path, look, complete)


def _rewrite(path: Path, number: int, change: Callable[[Look], Look]) -> Look:
    make_folder(path.parent)
    with lock_file(path):
        found = _read(path)
        if not 1 <= number <= len(found):
            raise LedgerError(f"{path}: there is no look {number}")
        before = found[number - 1][1]
        if before.state == "complete":
            raise LedgerError(f"{path}: look {number} is complete, its line stays as it is")
        after = change(before)
        lines = [line for line, _ in found]
        lines[number - 1] = _line(after)
        _write(path, lines)
    return after


def _write(path: Path, lines: Sequence[str]) -> None:
    write_bytes(path, "".join(f"{line}\n" for line in (",".join(COLUMNS), *lines)).encode())


def _seconds(now: datetime | None) -> datetime:
    return (now or datetime.now(UTC)).astimezone(UTC).replace(microsecond=0)


def check_whole(root: Path, ledger: Path) -> None:
    """Refuse a ledger that lacks a look which HEAD or a branch of this repository has.

    Args:
        root: A folder of the work tree.
        ledger: Its ledger.

    Raises:
        LedgerError: It lacks a look, the message names the remedy; or a ledger is damaged.
        CommitError: There is no repository.
    """
    here = {(look.look, look.begun) for look in read_ledger(ledger)}
    name = ledger.resolve().relative_to(work_tree(root)).as_posix()
    for reference, text in versions_of(root, name).items():
        for _, look in _lines(text, f"{name} of {reference}"):
            if (look.look, look.begun) not in here:
                raise LedgerError(
                    f"{ledger}: look {look.look} of {look.begun.date()} is missing, which {reference} has: "
                    f"'git checkout {reference} -- {name}' brings it back, 'git merge {reference}' also its results"
                )
