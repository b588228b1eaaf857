"""The figures of a log."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.controller.tick import Tick
from pepper_driver.log import Label, LogEvent, LogWriter, RunLog, read_log
from pepper_driver.log.summary import summarise
from pepper_driver.loop import TickRecord
from support.log_samples import ROBOT, Samples


def logged(path: Path, fill: Callable[[LogWriter, Samples], None]) -> RunLog:
    with LogWriter(path, ROBOT, {"start": "then"}, lossless=True) as log:
        fill(log, Samples(1))
    return read_log(path)


def aged(tick: Tick, age: float, dropped_commands: int) -> Tick:
    return replace(
        tick, measurement=replace(tick.measurement, age=age, dropped_commands=dropped_commands)
    )


def test_timing_of_a_paced_run(tmp_path: Path) -> None:
    def fill(log: LogWriter, samples: Samples) -> None:
        for number in range(101):
            tick = samples.tick(number if number < 50 else number + 3)
            tick = aged(tick, 0.001 * number, number // 20)
            log.append(
                TickRecord(tick=tick, tick_end=1e-4 * number, missed=0 if number < 50 else 2)
            )

    summary = summarise(logged(tmp_path / "a.mcap", fill))
    figures = summary.as_json()
    assert (figures["ticks"], figures["missed"], figures["absent"]) == (101, 2, 3)
    assert figures["dropped"] == 0, "cycles without a tick, but every tick is there"
    assert figures["dropped_commands"] == 5
    assert figures["duration"] == pytest.approx(103 * 0.012)
    assert figures["tick_end_ms"] == pytest.approx({"median": 5.0, "p99": 9.9, "max": 10.0})
    assert figures["sample_age_ms"] == pytest.approx({"median": 50.0, "p99": 99.0, "max": 100.0})
    assert (figures["complete"], figures["robot"]) == (True, ROBOT.name)
    json.dumps(figures, allow_nan=False)


def test_a_simulation_as_fast_as_it_goes_has_no_tick_end(tmp_path: Path) -> None:
    log = logged(
        tmp_path / "a.mcap", lambda log, samples: log.append(TickRecord(tick=samples.tick(3)))
    )
    assert summarise(log).as_json()["tick_end_ms"] is None
    ages = log.fields | {"age": np.array([np.nan])}
    assert summarise(replace(log, fields=ages)).as_json()["sample_age_ms"] is None


def test_what_happened_is_counted(tmp_path: Path) -> None:
    def fill(log: LogWriter, samples: Samples) -> None:
        def contact(number: int, phase: str, kind: str, joint: str | None) -> None:
            made = samples.contact(0)
            event = replace(made, id=number, phase=phase, kind=kind, joint=joint)  # type: ignore[arg-type]
            log.append(
                TickRecord(tick=samples.tick(number), observation=samples.observation(event))
            )

        contact(1, "begin", "contact", None)
        contact(1, "update", "contact", "LElbowRoll")  # it became clear only then
        contact(1, "end", "contact", "LElbowRoll")
        contact(2, "begin", "contact", "LElbowRoll")
        contact(3, "begin", "collision", None)
        for time, phase in ((1.0, "onset"), (2.0, "release"), (3.0, "onset")):
            label = Label(time=time, phase=phase, source="key")  # type: ignore[arg-type]
            log.append(TickRecord(tick=samples.tick(9), labels=[label]))
        log.note(LogEvent(time=1.0, kind="reflex", name="Hold", phase="begin"))
        log.note(LogEvent(time=1.0, kind="reflex", name="Soften", phase="begin"))
        log.note(LogEvent(time=2.0, kind="reflex", name="Hold", phase="end"))
        log.note(LogEvent(time=2.5, kind="reflex", name="Hold", phase="begin"))
        log.note(LogEvent(time=3.0, kind="fault", name="stale", text="no sample"))
        log.note(LogEvent(time=4.0, kind="fault", text="emergency stop"))

    figures = summarise(logged(tmp_path / "a.mcap", fill)).as_json()
    assert figures["contacts"] == {"total": 3, "contact": 2, "collision": 1}
    assert figures["contacts_of"] == {"LElbowRoll": 2, "trunk": 1}
    assert figures["reflexes"] == {"total": 3, "Hold": 2, "Soften": 1}
    assert figures["touches"] == 2
    assert figures["faults"] == 2
    assert figures["fault_reasons"] == ["stale: no sample", "emergency stop"]
    assert figures["metadata"] == {"start": "then"}


def test_a_log_without_ticks_has_no_figures(tmp_path: Path) -> None:
    figures = summarise(logged(tmp_path / "a.mcap", lambda log, samples: None)).as_json()
    assert (figures["ticks"], figures["duration"], figures["missed"]) == (0, 0.0, 0)
    assert figures["tick_end_ms"] is figures["sample_age_ms"] is None
    assert figures["contacts"] == {"total": 0}
