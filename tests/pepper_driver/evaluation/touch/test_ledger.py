"""The ledger of the test split: its lines, the draws, and looks that other branches have."""

import math
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import cluster, load_observer_settings
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.file_lock import InUseError, lock_file
from pepper_driver.evaluation.touch import ledger as module
from pepper_driver.evaluation.touch.ledger import (
    COLUMNS,
    LedgerError,
    Look,
    MainResults,
    begin_look,
    check_whole,
    code_hash,
    complete_look,
    constants_hash,
    has_changed,
    look_folder,
    next_draws,
    read_ledger,
    update_look,
)
from support.repositories import git, make_repository

BEGUN = datetime(2026, 3, 1, 20, 15, 30, tzinfo=UTC)
ENDED = BEGUN + timedelta(hours=11)
RESULTS = MainResults(
    false_contacts=20,
    hours=30.0,
    n90_standing_nominal=math.inf,
    n90_standing_integral=18.234567,
    n90_moving_nominal=9.0,
    n90_moving_integral=None,
    delay_ms=143.7,
)
CODE: dict[str, Any] = {"commit": "c0ffee", "code": "aaaa", "constants": "bbbb", "suites": "5555"}


def begin(path: Path, *, note: str = "", give_up: bool = False, **changed: Any) -> Look:
    return begin_look(path, **{**CODE, **changed}, note=note, give_up=give_up, now=BEGUN)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "docs" / "results" / "ledger.csv"


# -- lines ------------------------------------------------------------------------------------------------------------


def test_a_look_is_a_line_from_its_begin_to_its_end(path: Path) -> None:
    assert read_ledger(path) == ()
    look = begin(path, note="today's observer, as it is")
    header, line = path.read_text().splitlines()
    assert header.split(",") == list(COLUMNS)
    assert line == (
        "1,2026-03-01T20:15:30+00:00,,c0ffee,aaaa,bbbb,5555,100-119,begun,0,20,,,,,,,,,"
        '"today\'s observer, as it is"'
    )
    assert look.numbers == tuple(range(100, 120))
    update_look(path, 1, robots_done=13)
    assert read_ledger(path) == (replace(look, robots_done=13),)
    done = complete_look(path, 1, RESULTS, now=ENDED.astimezone(timezone(timedelta(hours=2))))
    assert read_ledger(path) == (done,)
    assert path.read_text().splitlines()[1] == (
        "1,2026-03-01T20:15:30+00:00,2026-03-02T07:15:30+00:00,c0ffee,aaaa,bbbb,5555,100-119,complete,20,20,"
        '20,30,0.6667,>30,18.23,9,,143.7,"today\'s observer, as it is"'
    )
    assert done.results.false_per_hour == pytest.approx(2 / 3)
    assert done.results.n90_standing_nominal == math.inf
    assert done.ended == ENDED
    assert MainResults(false_contacts=1, hours=0.0).false_per_hour is None


def test_only_its_own_line_is_rewritten(path: Path) -> None:
    begin(path)
    complete_look(path, 1, RESULTS, now=ENDED)
    # As another program writes the same line.
    header, line = path.read_text().splitlines()
    quoted = line.replace("c0ffee", '"c0ffee"')
    path.write_text(f"{header}\n{quoted}\n")
    second = begin(path, code="cccc")
    complete_look(path, second.look, RESULTS, note="after a change", now=ENDED)
    lines = path.read_text().splitlines()
    assert lines[:2] == [header, quoted]
    assert lines[2].endswith(",after a change")
    before = path.read_bytes()
    for number, text in ((1, "look 1 is complete"), (3, "no look 3"), (0, "no look 0")):
        with pytest.raises(LedgerError, match=text):
            complete_look(path, number, RESULTS)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (("complete", "done"), "'state' is 'done'"),
        (("c0ffee,", ""), "20 values are due"),
        (("200-219", "200-218"), "'robots' does not fit"),
        (("2026-03-01T20:15:30+00:00", "yesterday"), "'begun' is 'yesterday'"),
        (("2026-03-02T07:15:30+00:00", ""), "'ended' and 'state'"),
        (("0.6667", "0.1"), "'false_per_hour' is not"),
        ((",30,", ",nan,"), "'hours' is 'nan'"),
        (("\n2,", "\n3,"), "look 3 where look 2 is due"),
        (("\n2,", '\n"2,'), "damaged"),
        (("\n2,", "\n\n2,"), "20 values are due"),
        (("c0ffee", "c0ffee "), "'commit' is 'c0ffee '"),
    ],
)
def test_a_damaged_line_is_named_and_never_repaired(
    path: Path, wrong: tuple[str, str], text: str
) -> None:
    begin(path)
    complete_look(path, 1, RESULTS, now=ENDED)
    begin(path, code="cccc")
    complete_look(path, 2, RESULTS, now=ENDED)
    whole = path.read_text()
    at = whole.rindex(wrong[0])
    damaged = whole[:at] + wrong[1] + whole[at + len(wrong[0]) :]
    path.write_text(damaged)
    for use in (
        lambda: read_ledger(path),
        lambda: begin(path, code="dddd"),
        lambda: update_look(path, 1, robots_done=3),
    ):
        with pytest.raises(LedgerError, match=f"ledger.csv line 3: .*{text}"):
            use()
    assert path.read_text() == damaged


def test_what_is_no_ledger_is_refused(path: Path) -> None:
    path.parent.mkdir(parents=True)
    path.write_text("look,begun\n")
    with pytest.raises(LedgerError, match="line 1: not the columns of a ledger"):
        begin(path)
    path.write_bytes(b"\xff\n")
    with pytest.raises(LedgerError, match="not UTF-8"):
        read_ledger(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(LedgerError, match="it is a folder"):
        read_ledger(path)


def test_nothing_wrong_is_written(path: Path) -> None:
    with pytest.raises(LedgerError, match="one line"):
        begin(path, note="two\nlines")
    assert not path.exists()
    begin(path)
    before = path.read_bytes()
    with pytest.raises(LedgerError, match="'delay_ms' is 'nan'"):
        complete_look(path, 1, replace(RESULTS, delay_ms=math.nan))
    with pytest.raises(LedgerError, match="'hours' is"):
        complete_look(path, 1, replace(RESULTS, hours=math.inf))
    with pytest.raises(LedgerError, match="fewer than are done"):
        update_look(path, 1, robots_done=21)
    assert path.read_bytes() == before


def test_one_run_writes_at_a_time(path: Path) -> None:
    begin(path)
    with lock_file(path), pytest.raises(InUseError, match="is being written by"):
        update_look(path, 1, robots_done=1)
    complete_look(path, 1, RESULTS)
    results: list[object] = []

    def run(code: str) -> None:
        try:
            results.append(begin(path, code=code))
        except (InUseError, LedgerError) as error:
            results.append(error)

    threads = [threading.Thread(target=run, args=(code,)) for code in ("cccc", "dddd")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    begun = [one for one in results if isinstance(one, Look)]
    assert len(results) == 2
    assert len(begun) == 1
    assert [look.look for look in read_ledger(path)] == [1, 2]


# -- draws ------------------------------------------------------------------------------------------------------------


def test_draws_are_looked_at_once(path: Path) -> None:
    """Refused without a change; the next hundred after one; also where the change is of constants or suites alone."""
    begin(path)
    complete_look(path, 1, RESULTS)
    with pytest.raises(LedgerError, match=r"already looked at on 2026-03-01 .*100-119.*look-1"):
        begin(path)
    with pytest.raises(LedgerError, match="already looked at"):
        begin(path, commit="b0ffee")  # which differs by nothing that counts
    for number, changed in enumerate(("code", "constants", "suites"), 2):
        look = begin(path, **dict[str, Any]({changed: "cc"}))
        assert look.numbers == tuple(range(100 * number, 100 * number + 20))
        complete_look(path, look.look, RESULTS)
    assert look_folder(path, 4) == path.parent / "look-4"


def test_an_unfinished_look_is_resumed_on_its_own_line(path: Path) -> None:
    first = begin(path)
    update_look(path, 1, robots_done=3)
    before = path.read_bytes()
    resumed = begin(path, commit="b0ffee", note="later")
    assert resumed == replace(first, robots_done=3)
    with pytest.raises(
        LedgerError, match=r"look 1 .*unfinished \(3 of 20 robots\).*undo that.*c0ffee.*--give-up"
    ):
        begin(path, code="cccc")
    assert path.read_bytes() == before
    # Its draws may have been seen: they are not used again, also when nothing has changed.
    second = begin(path, give_up=True)
    assert second.draws == "200-219"
    assert read_ledger(path) == (resumed, second)
    complete_look(path, 2, RESULTS)
    assert begin(path, code="cccc").draws == "300-319"


def test_what_counts_as_a_change() -> None:
    look = Look(look=1, begun=BEGUN, draws="100-119", robots=20, **CODE)
    same = {name: CODE[name] for name in ("code", "constants", "suites")}
    assert not has_changed(look, **same)
    for name in same:
        assert has_changed(look, **{**same, name: "other"})
    assert next_draws((), True) == next_draws((look,), False) == tuple(range(100, 120))


def test_hashes_cover_code_and_settings_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a copy of the places that the hash of files reads."""
    for name in ("observer/a.py", "config/observer.yaml", "config/evaluation_baselines.yaml"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("1")
    (tmp_path / "cli").mkdir()
    (tmp_path / "cli" / "b.py").write_text("1")

    class Spec:
        def __init__(self, name: str) -> None:
            part = name.removeprefix("pepper_driver").removeprefix(".")
            self.submodule_search_locations = [str(tmp_path / part)]

    monkeypatch.setattr(cluster, "find_spec", Spec)
    before = code_hash()
    for name in ("config/observer.yaml", "config/evaluation_baselines.yaml", "cli/b.py"):
        (tmp_path / name).write_text("2")
    assert code_hash() == before
    (tmp_path / "observer" / "a.py").write_text("2")
    assert code_hash() != before

    settings, baselines = load_observer_settings(), load_evaluation_baselines()
    hashes = {constants_hash()}
    for name, value in (
        ("load_observer_settings", replace(settings, fusion_window=7)),
        (
            "load_evaluation_baselines",
            replace(baselines, factors=baselines.factors | {"error": 2.0}),
        ),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, lambda value=value: value)
            hashes.add(constants_hash())
    assert len(hashes) == 3
    monkeypatch.setattr(
        module, "load_evaluation_baselines", lambda: replace(baselines, chosen_on="other takes")
    )
    assert constants_hash() in hashes  # a reason in words changes no result


# -- branches ---------------------------------------------------------------------------------------------------------


def test_a_ledger_that_lacks_a_look_of_a_branch_is_refused(tmp_path: Path) -> None:
    repository = make_repository(tmp_path / "repository")
    ledger = repository / "docs" / "results" / "ledger.csv"
    check_whole(repository, ledger)
    main = git(repository, "rev-parse", "--abbrev-ref", "HEAD")
    git(repository, "branch", "before")
    begin(ledger)
    check_whole(repository, ledger)  # not committed yet
    git(repository, "add", "-A")
    git(repository, "commit", "-qm", "look")
    check_whole(repository, ledger)
    ledger.unlink()
    with pytest.raises(LedgerError, match=r"look 1 of .* is missing, which HEAD has"):
        check_whole(repository, ledger)
    git(repository, "checkout", "-q", "--", ".")
    git(repository, "checkout", "-q", "-b", "damaged")
    ledger.write_text(ledger.read_text().replace("\n1,", "\nx,"))
    git(repository, "commit", "-qam", "damaged")
    git(repository, "checkout", "-q", main)
    with pytest.raises(LedgerError, match=r"ledger.csv of damaged line 2: damaged"):
        check_whole(repository, ledger)
    git(repository, "branch", "-q", "-D", "damaged")
    git(repository, "checkout", "-q", "before")
    with pytest.raises(LedgerError, match=f"is missing, which {main} has: 'git checkout {main} --"):
        check_whole(repository, ledger)
