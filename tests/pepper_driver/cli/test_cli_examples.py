"""``pepper examples``. That a wheel has them: tests/test_packaging.py."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from support import ROOT

EXAMPLES = ROOT / "examples"


def test_each_example_is_listed_with_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["examples"]) == 0
    lines = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[:-1]]
    assert all(len(words) == 2 for words in lines)
    names = [name for name, _ in lines]
    assert {path.name for path in EXAMPLES.glob("*.py")} <= set(names)
    assert {"experiments/retract.yaml", "plugins/reflex"} <= set(names)


def test_what_examples_show_begins_in_one_column(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["examples"]) == 0
    *lines, _ = capsys.readouterr().out.splitlines()
    assert (
        len({len(name) + len(gap) for name, gap in re.findall(r"(?m)^(\S+)( +)", "\n".join(lines))})
        == 1
    )


def test_copies_run_and_replace_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "mine"
    assert run(["examples", str(out)]) == 0
    assert f"files in {out}" in capsys.readouterr().out
    for path in EXAMPLES.rglob("*.yaml"):
        assert (out / path.relative_to(EXAMPLES)).read_bytes() == path.read_bytes()
    assert not list(out.rglob("__pycache__"))
    assert run(["run", str(out / "experiments" / "retract.yaml"), "--dry-run"]) == 0
    capsys.readouterr()

    changed = out / "plugins" / "reflex" / "lift_arm.py"
    for path in out.rglob("*"):
        if path.is_file() and path != changed:
            path.unlink()
    changed.write_text("mine")
    assert run(["examples", str(out)]) == 2
    assert capsys.readouterr().err == (
        f"pepper: {changed}: is there already; choose another folder\n"
    )
    assert changed.read_text() == "mine"
    assert [path for path in out.rglob("*") if path.is_file()] == [changed]


def test_a_place_that_cannot_be_written_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["examples", "/dev/null/x"]) == 2
    assert capsys.readouterr().err.startswith("pepper: /dev/null/x: cannot be made")
