"""The demonstration: a simulated Pepper moves its arms, is pushed, and says what it felt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pepper_driver.config import ConfigError, RobotConfig, Scenario, load_robot, load_scenario
from pepper_driver.config.scenario_motion import Script, Setpoints
from pepper_driver.observer import Contact, Push, Score, score
from pepper_driver.output import check_writable, make_folder, write_json
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper
from pepper_driver.staging import Stage, scenario_uri

LOG_NAME, CONTACTS_NAME, FIGURE_NAME = "demo.mcap", "contacts.json", "contacts.png"


@dataclass(frozen=True, kw_only=True)
class DemoResult:
    """What happened: the pushes, all contact events, how they match, and how the ticks went."""

    uri: str
    scenario: str
    pushes: tuple[Push, ...]
    contacts: tuple[Contact, ...]
    score: Score
    simulated_seconds: float
    timing: Statistics

    def as_json(self) -> dict[str, Any]:
        """Everything, for ``contacts.json``."""
        score = self.score
        return {
            "uri": self.uri,
            "scenario": self.scenario,
            "summary": self.summary,
            "felt": [
                {"push": asdict(f.push), "contact": asdict(f.contact), "delay": f.delay}
                for f in score.felt
            ],
            "missed": [asdict(push) for push in score.missed],
            "false": [asdict(contact) for contact in score.false],
            "rebounds": [asdict(contact) for contact in score.rebounds],
            "repeated": [asdict(contact) for contact in score.repeated],
            "events": [asdict(contact) for contact in self.contacts],
        }

    @property
    def summary(self) -> dict[str, Any]:
        """The figures of the run: counts of pushes and contacts, right answers, delays from the onset of the force."""
        felt = self.score.felt
        delays = [1e3 * f.delay for f in felt]
        return {
            "simulated_seconds": self.simulated_seconds,
            "pushes": len(self.pushes),
            "felt": len(felt),
            "missed": len(self.score.missed),
            "false": len(self.score.false),
            "rebounds": len(self.score.rebounds),
            "repeated": len(self.score.repeated),
            "saturated": sum(push.saturated for push in self.pushes),
            "force_n": _extent([push.force for push in self.pushes]),
            "degrees": _extent([push.degrees for push in self.pushes]),
            "direction_right": sum(f.settled.direction == f.push.direction for f in felt),
            "joint_right": sum(f.settled.joint == f.push.joint for f in felt),
            "delay_ms": {
                "median": float(np.median(delays)) if delays else None,
                "p90": float(np.percentile(delays, 90)) if delays else None,
            },
        }


def _extent(values: list[float]) -> dict[str, float | None]:
    return {"least": min(values, default=None), "most": max(values, default=None)}


def demo_scenario(name: str | Path, robot: RobotConfig) -> Scenario:
    """A scenario by name or file that a demonstration can show.

    Raises:
        PepperError: There is none of this name, it is wrong, or its motion is no demonstration.
    """
    scenario = load_scenario(name, robot)
    if not isinstance(scenario.motion, Setpoints | Script):
        raise ConfigError(
            f"{scenario.source}: key 'motion.kind': a demonstration takes setpoints or script, "
            f"not {scenario.motion.kind}"
        )
    if not scenario.contacts:
        raise ConfigError(f"{scenario.source}: key 'contacts': a demonstration needs some")
    return scenario


def run_demo(
    out: Path,
    *,
    scenario: str | Path = "demo",
    seconds: float | None = None,
    seed: int | None = None,
    models: Path | None = None,
    show: bool = False,
    real_time: bool = False,
    on_contact: Callable[[Contact, tuple[Push, ...]], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> DemoResult:
    """Run the demonstration and write log and contacts.

    Args:
        out: Folder for the results; made when it does not exist.
        scenario: Motion and contacts, by name or file.
        seconds: Simulated time [s]; as many whole periods of the scenario as fit into it. None for the scenario's own.
        seed: Of motion, pushes and noise; None for the scenario's.
        models: Model file of the observer; None for the shipped one.
        show: Show the robot in a window, in real time.
        real_time: Pace the simulation to the wall clock without a window too.
        on_contact: Told each contact that begins, with the pushes so far; on the callback thread.
        on_progress: Told the share done, 0..1.

    Raises:
        PepperError: The folder cannot be written, or the scenario, the robot or the models refuse; nothing has moved.
    """
    robot = load_robot()
    chosen = demo_scenario(scenario, robot)
    count = _count(chosen, seconds)
    seed = chosen.seed if seed is None else seed
    uri = scenario_uri(f"mujoco://?seed={seed}" + ("&window=1" if show else ""), chosen)
    pepper = Pepper(
        uri,
        models=models,
        log=out / LOG_NAME,
        reflexes=[Hold()],
        real_time=show or real_time,
        robot=robot,
    )
    stage = Stage(pepper, chosen, [seed, 1], count=count)
    make_folder(out)
    for name in (CONTACTS_NAME, FIGURE_NAME):
        check_writable(out / name)
    if on_contact is not None:
        tell = on_contact

        @pepper.on_contact()
        def _(contact: Contact) -> None:
            tell(contact, stage.pushes)

    with pepper:
        for name in (
            CONTACTS_NAME,
            FIGURE_NAME,
        ):  # of an earlier run: they would not fit the new log
            (out / name).unlink(missing_ok=True)
        start = pepper.time
        stage.perform(on_progress=on_progress)
        simulated = pepper.time - start
    result = DemoResult(
        uri=uri,
        scenario=chosen.name,
        pushes=stage.pushes,
        contacts=pepper.contact_history,
        score=score(stage.pushes, pepper.contact_history, robot),
        simulated_seconds=simulated,
        timing=pepper.statistics,
    )
    write_json(out / CONTACTS_NAME, result.as_json())
    return result


def _count(scenario: Scenario, seconds: float | None) -> int | None:
    """How many whole periods fit into a time; None for the scenario's own number."""
    if seconds is None:
        return None
    if not isinstance(scenario.motion, Setpoints):
        raise ConfigError(f"scenario '{scenario.name}' has a length of its own: leave out seconds")
    period = scenario.motion.period
    count = int(seconds // period) if np.isfinite(seconds) else 0
    if count < 1:
        raise ConfigError(f"seconds must be at least {period:g}, got {seconds:g}")
    return count
