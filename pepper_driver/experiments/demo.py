"""The demonstration: a simulated Pepper moves its arms, is pushed, and reports the contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pepper_driver.callbacks.events import PushEvent
from pepper_driver.config import (
    ConfigError,
    Experiment,
    PepperError,
    RobotConfig,
    load_experiment,
    load_robot,
)
from pepper_driver.config.experiment import DAY
from pepper_driver.config.files import check_writable, make_folder, write_json
from pepper_driver.config.steps import Setpoints
from pepper_driver.experiments.plan import experiment_uri, plan_experiment
from pepper_driver.observer import Contact, ContactScore, KnownPush, score
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper

LOG_NAME, CONTACTS_NAME, FIGURE_NAME = "demo.mcap", "contacts.json", "contacts.png"

EVENT_SETTLING_TIME = 0.15
"""[s] After its detection a contact may still move to another joint or limb."""


@dataclass(frozen=True, kw_only=True)
class DemoResult:
    """Results of the demonstration: pushes, contact events, their matches, and timing of the ticks.

    ``complete`` is False where the run was interrupted or stopped.
    """

    uri: str
    experiment: str
    complete: bool
    pushes: tuple[KnownPush, ...]
    contacts: tuple[Contact, ...]
    score: ContactScore
    simulated_seconds: float
    timing: Statistics

    def as_json(self) -> dict[str, Any]:
        """Everything, for ``contacts.json``."""
        score = self.score
        return {
            "uri": self.uri,
            "experiment": self.experiment,
            "complete": self.complete,
            "summary": self.summary,
            "detected": [
                {"push": asdict(f.push), "contact": asdict(f.contact), "delay": f.delay}
                for f in score.detected
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
        detected = self.score.detected
        delays = [1e3 * f.delay for f in detected]
        return {
            "simulated_seconds": self.simulated_seconds,
            "pushes": len(self.pushes),
            "detected": len(detected),
            "missed": len(self.score.missed),
            "false": len(self.score.false),
            "rebounds": len(self.score.rebounds),
            "repeated": len(self.score.repeated),
            "saturated": sum(push.saturated for push in self.pushes),
            "force_n": _extent([push.force for push in self.pushes]),
            "degrees": _extent([push.degrees for push in self.pushes]),
            "direction_right": sum(f.direction_right for f in detected),
            "joint_right": sum(f.joint_right for f in detected),
            "delay_ms": {
                "median": float(np.median(delays)) if delays else None,
                "p90": float(np.percentile(delays, 90)) if delays else None,
            },
        }


def _extent(values: list[float]) -> dict[str, float | None]:
    return {"least": min(values, default=None), "most": max(values, default=None)}


def demo_experiment(name: str | Path, robot: RobotConfig) -> Experiment:
    """Load an experiment that a demonstration can show.

    Raises:
        PepperError: No such demonstration, or its file is invalid.
    """
    experiment = load_experiment(name, robot)
    if not experiment.contacts:
        raise experiment.error("contacts", "a demonstration needs some")
    return experiment


def run_demo(
    out: Path,
    *,
    experiment: str | Path = "demo",
    seconds: float | None = None,
    seed: int | None = None,
    models: Path | None = None,
    show: bool = False,
    real_time: bool = False,
    view: Callable[[Pepper], AbstractContextManager[object]] | None = None,
    on_contact: Callable[[Contact, tuple[KnownPush, ...]], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> DemoResult:
    """Run the demonstration and write log and contacts: those so far where it is interrupted or stopped.

    Args:
        out: Folder for the results; made when it does not exist.
        experiment: Steps and contacts, by name or file.
        seconds: Simulated time [s]; as many random goals as fit into it. None for the experiment's own number.
        seed: Of motion, pushes and noise; None for the experiment's.
        models: Model file of the observer; None for the shipped one.
        show: Show the robot in a window, in real time.
        real_time: Pace the simulation to the wall clock without a window too.
        view: Shows the robot, in real time, as long as the block is open that it makes.
        on_contact: Called with each contact, as it is SETTLING_TIME after its detection or at its earlier end, and with
            the pushes so far; on the callback thread.
        on_progress: Called with the fraction done, 0..1.

    Raises:
        PepperError: The folder cannot be written, or the experiment, the robot or the models refuse; nothing has moved.
    """
    robot = load_robot()
    chosen = _shortened(demo_experiment(experiment, robot), seconds)
    seed = chosen.seed if seed is None else seed
    uri = experiment_uri(f"mujoco://?seed={seed}" + ("&window=1" if show else ""), chosen)
    pepper = Pepper(
        uri,
        models=models,
        log=out / LOG_NAME,
        reflexes=[Hold()],
        real_time=show or real_time or view is not None,
        robot=robot,
    )
    plan = plan_experiment(chosen, robot, pepper.backend, seed=[seed, 1])
    make_folder(out)
    for name in (CONTACTS_NAME, FIGURE_NAME):
        check_writable(out / name)
    report_contact = on_contact or (lambda *_: None)
    unsettled: dict[int, Contact] = {}
    pushes: list[KnownPush] = []

    @pepper.on_push()
    def _(event: PushEvent) -> None:
        pushes.extend([event.push] if event.push else [])

    @pepper.on_contact(phase=None)
    def _(contact: Contact) -> None:
        if contact.phase == "begin" or contact.id in unsettled:
            unsettled[contact.id] = contact
        settled = (
            contact.time - contact.detection_time >= EVENT_SETTLING_TIME or contact.phase == "end"
        )
        if settled and unsettled.pop(contact.id, None) is not None:
            report_contact(contact, tuple(pushes))

    def finish(performed: Sequence[KnownPush], seconds: float, *, complete: bool) -> DemoResult:
        for contact in unsettled.values():
            report_contact(contact, tuple(pushes))
        result = DemoResult(
            uri=uri,
            experiment=chosen.name,
            complete=complete,
            pushes=tuple(performed),
            contacts=pepper.contact_history,
            score=score(performed, pepper.contact_history, robot),
            simulated_seconds=seconds,
            timing=pepper.statistics,
        )
        write_json(out / CONTACTS_NAME, result.as_json())
        return result

    start = end = report = None
    try:
        with nullcontext() if view is None else view(pepper), pepper:
            # Of an earlier run: they would not fit the new log.
            for name in (CONTACTS_NAME, FIGURE_NAME):
                (out / name).unlink(missing_ok=True)
            start = pepper.time
            try:
                report = pepper.play(plan, on_progress=on_progress)
            finally:
                end = pepper.time
    except (KeyboardInterrupt, PepperError) as error:
        if start is not None and end is not None:
            begun = report.pushes if report else [push for push in pushes if push.onset <= end]
            finish(begun, end - start, complete=report is not None)
            error.add_note(f"contacts: {out / CONTACTS_NAME}")
        raise
    return finish(report.pushes, end - start, complete=True)


def _shortened(experiment: Experiment, seconds: float | None) -> Experiment:
    """Return it with as many goals as fit into a time [s]; as it is for None."""
    if seconds is None:
        return experiment
    step = experiment.random_step
    if step is None or not isinstance(step.goals, Setpoints):
        raise ConfigError(f"'{experiment.name}' has a length of its own: leave out seconds")
    period = step.goals.period
    count = int(seconds // period) if np.isfinite(seconds) else 0
    if count < 1:
        raise ConfigError(f"seconds must be at least {period:g}, got {seconds:g}")
    # The motion to the first goal and the last steps are added.
    return replace(experiment.with_goals(count=count), max_duration=DAY)
