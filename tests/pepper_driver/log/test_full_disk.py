"""A disk that is full during a run: said at once, and the run and its summary are kept."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from pepper_driver.log import read_log
from support.full_disk import limit_disk

EXPERIMENT = "schema: 2\nname: short\nsteps:\n- {posture: Stand, duration: 2.0}\n"


@pytest.mark.parametrize(("what", "name"), [("short.yaml", "short"), ("wave", "wave")])
def test_the_summary_comes_before_the_error(
    what: str,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(EXPERIMENT)
    limit_disk(monkeypatch, 60_000)
    with caplog.at_level(logging.ERROR):
        assert run(["run", what, "--log", "run.mcap", "--json", "figures.json"]) == 1
    assert caplog.messages == ["run.mcap: log is cut short (the disk is full)"]
    captured = capsys.readouterr()
    assert captured.err == "pepper: run.mcap: log is cut short (the disk is full)\n"
    assert f"{name}: completed" in captured.out
    assert json.loads(Path("figures.json").read_text())["steps"]
    assert not read_log(Path("run.mcap")).complete
