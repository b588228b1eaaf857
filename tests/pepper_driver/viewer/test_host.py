"""A robot that runs for its page: what it plays, how it starts again, and what it refuses."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from pepper_driver import Pepper, PepperError
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import load_robot
from pepper_driver.log import read_log
from pepper_driver.viewer.host import Host, HostedRun, default_gains, make_gained_reflexes
from support.waiting import PATIENCE, wait_until

RESTART: dict[str, Any] = {
    "plant": "worn",
    "observer": "momentum",
    "reflexes": {"hold": {"release_delay": 0.2}},
}


class Enough(Exception):
    """Ends a host."""


def run_in_thread(host: Host, runs: int) -> tuple[threading.Thread, list[Pepper]]:
    """Have a host run until it would begin a run more."""
    begun: list[Pepper] = []

    def on_run(pepper: Pepper) -> None:
        if len(begun) == runs:
            raise Enough
        begun.append(pepper)

    def run() -> None:
        with pytest.raises(Enough):
            host.run(on_run)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread, begun


@pytest.mark.realtime
def test_it_begins_again_with_what_the_page_chose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "run.mcap"
    host = Host(HostedRun(uri="mujoco://?seed=4", log=log, reflexes={"comply": {}}))
    thread, begun = run_in_thread(host, 2)
    assert wait_until(lambda: bool(begun) and begun[0].state.value == "active")
    host.perform("restart", RESTART)
    assert wait_until(lambda: len(begun) == 2 and begun[1].state.value == "active")
    assert begun[0].state.value == "inactive"
    next_run, waiting = host._next_run, threading.Event()

    def wait_for_the_page() -> HostedRun:
        waiting.set()
        return next_run()

    monkeypatch.setattr(host, "_next_run", wait_for_the_page)
    begun[1].emergency_stop("enough")
    assert waiting.wait(PATIENCE)
    host.perform("restart", RESTART)
    thread.join(PATIENCE)
    assert not thread.is_alive()
    first, second = read_log(log), read_log(tmp_path / "run_2.mcap")
    assert "worn" in second.metadata["backend"]
    assert "seed=4" in second.metadata["backend"]
    assert "momentum" in second.metadata["observer"]
    assert '"hold"' in second.metadata["reflexes"]
    assert "worn" not in first.metadata["backend"]


@pytest.mark.parametrize(("plant", "kept"), [("random", {"draw": "3", "day": "2"}), ("worn", {})])
def test_draw_and_day_are_of_their_plant(plant: str, kept: dict[str, str]) -> None:
    host = Host(HostedRun(uri="mujoco://?plant=random&draw=3&day=2"))
    uri = host._changed(**{**RESTART, "plant": plant}).uri
    assert parse_uri(uri).query == {"plant": plant, **kept}


@pytest.mark.realtime
def test_it_plays_what_the_page_asks_for() -> None:
    host = Host(HostedRun(uri="mujoco", observer=None))
    _, begun = run_in_thread(host, 1)
    assert wait_until(lambda: bool(begun) and begun[0].state.value == "active")
    steps: list[str] = []
    begun[0].on_step()(lambda event: steps.append(event.step))
    host.perform("play", {"name": "wave"})
    assert wait_until(lambda: bool(steps))
    begun[0].emergency_stop("enough")
    host.perform("restart", RESTART)


@pytest.mark.parametrize(
    ("do", "change", "word"),
    [
        ("play", {"name": "wvae"}, "wave"),
        ("restart", {**RESTART, "plant": "wron"}, "worn"),
        ("restart", {**RESTART, "observer": "fusoin"}, "fusion"),
        ("restart", {**RESTART, "reflexes": {"hodl": {}}}, "hold"),
        ("restart", {**RESTART, "reflexes": {"comply": {"gain": 7.0}}}, "gain"),
    ],
)
def test_a_mistake_is_reported_at_once_and_nothing_begins(
    do: str, change: dict[str, Any], word: str
) -> None:
    host = Host(HostedRun(uri="mujoco", observer=None))
    with pytest.raises(PepperError, match=word):
        host.perform(do, change)
    assert host._asked.empty()


def test_a_real_robot_is_not_begun_again() -> None:
    host = Host(HostedRun(uri="naoqi://pepper.local", observer=None))
    with pytest.raises(PepperError, match="real robot"):
        host.perform("restart", RESTART)
    assert "plants" not in host.choices


def test_every_kind_of_reflex_can_be_made_of_what_is_offered() -> None:
    robot = load_robot()
    gains = default_gains(robot)
    assert {"comply", "hold", "retract"} <= set(gains)
    for kind, numbers in gains.items():
        (reflex,) = make_gained_reflexes({kind: numbers}, robot)
        for name, value in numbers.items():
            assert getattr(reflex, name) == value
