"""The demonstration: a simulated Pepper moves its arms, is pushed, and says what it felt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pepper_driver.config import ConfigError, DemoScenario, RobotConfig, load_demo_scenario
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, Observation, Push, Score, score
from pepper_driver.output import check_writable, make_folder, write_json
from pepper_driver.pushing import PlannedPush, PushTooStrongError, plan_push
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper

LOG_NAME, CONTACTS_NAME, FIGURE_NAME = "demo.mcap", "contacts.json", "contacts.png"


@dataclass(frozen=True, kw_only=True)
class DemoResult:
    """What happened: the pushes, all contact events, and how they match."""

    uri: str
    pushes: tuple[Push, ...]
    contacts: tuple[Contact, ...]
    score: Score
    simulated_seconds: float

    def as_json(self) -> dict[str, Any]:
        """Everything, for ``contacts.json``."""
        score = self.score
        return {
            "uri": self.uri,
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
            "direction_right": sum(f.contact.direction == f.push.direction for f in felt),
            "joint_right": sum(f.contact.joint == f.push.joint for f in felt),
            "delay_ms": {
                "median": float(np.median(delays)) if delays else None,
                "p90": float(np.percentile(delays, 90)) if delays else None,
            },
        }


def run_demo(
    out: Path,
    *,
    seconds: float = 48.0,
    seed: int = 0,
    models: Path | None = None,
    show: bool = False,
    on_contact: Callable[[Contact, tuple[Push, ...]], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> DemoResult:
    """Run the demonstration and write log and contacts.

    Args:
        out: Folder for the results; made when it does not exist.
        seconds: Simulated time [s]; as many whole periods of the scenario as fit into it.
        seed: Of motion, pushes and noise.
        models: Model file of the observer; None for the shipped one.
        show: Show the robot in a window, in real time.
        on_contact: Told each contact that begins, with the pushes so far; on the callback thread.
        on_progress: Told the share done, 0..1.

    Raises:
        PepperError: The folder cannot be written, or the robot or the models refuse; nothing has moved.
    """
    uri = f"mujoco://?seed={seed}" + ("&window=1" if show else "")
    pepper = Pepper(uri, models=models, log=out / LOG_NAME, reflexes=[Hold()], real_time=show)
    scenario = load_demo_scenario(pepper.config)
    periods = int(seconds // scenario.period) if np.isfinite(seconds) else 0
    if periods < 1:
        raise ConfigError(f"seconds must be at least {scenario.period:g}, got {seconds:g}")
    make_folder(out)
    for name in (CONTACTS_NAME, FIGURE_NAME):
        check_writable(out / name)
    director = _Director(pepper, scenario, np.random.default_rng([seed, 1]))
    if on_contact is not None:
        tell = on_contact

        @pepper.on_contact()
        def _(contact: Contact) -> None:
            tell(contact, tuple(director.pushes))

    steps = 8  # reports of progress in a period
    with pepper:
        for name in (
            CONTACTS_NAME,
            FIGURE_NAME,
        ):  # of an earlier run: they would not fit the new log
            (out / name).unlink(missing_ok=True)
        start = pepper.time
        pepper.set_posture("Stand", stiffness=scenario.stiffness)
        for period in range(periods):
            director.next_period()
            for step in range(1, steps + 1):
                pepper.run(scenario.period / steps, on_tick=director.watch)
                if on_progress is not None:
                    on_progress((period + step / steps) / periods)
        seconds = pepper.time - start
    result = DemoResult(
        uri=uri,
        pushes=tuple(director.pushes),
        contacts=pepper.contacts,
        score=score(director.pushes, pepper.contacts, pepper.config),
        simulated_seconds=seconds,
    )
    write_json(out / CONTACTS_NAME, result.as_json())
    return result


class _Director:
    """Says where the arms go and when they are pushed."""

    def __init__(self, pepper: Pepper, scenario: DemoScenario, rng: np.random.Generator) -> None:
        self._pepper = pepper
        self._scenario = scenario
        self._rng = rng
        self.pushes: list[Push] = []

    def next_period(self) -> None:
        """New set-points, and the pushes of one period."""
        pepper, scenario, rng = self._pepper, self._scenario, self._rng
        robot = pepper.config
        targets = {name: _angle(robot, name, scenario.range, rng) for name in scenario.joints}
        targets |= {
            name: _angle(robot, name, scenario.also_range, rng) for name in scenario.also_move
        }
        pepper.set_posture(targets)
        posture = pepper.target
        for number, time in enumerate(scenario.push_times):
            delay = time + rng.uniform(-0.5, 0.5) * scenario.push_jitter
            duration = rng.uniform(*scenario.duration)
            planned = self._plan(posture)
            pepper.push(
                planned.link, planned.force, planned.point, duration, frame="link", delay=delay
            )
            onset = pepper.time + delay
            self.pushes.append(
                Push(
                    joint=planned.joint,
                    link=planned.link,
                    direction=int(np.sign(planned.torque)),
                    torque=abs(planned.torque),
                    degrees=planned.degrees,
                    onset=onset,
                    release=onset + duration,
                    moving=number == 0,
                )
            )

    def watch(self, tick: Tick, _: Observation | None) -> None:
        """Mark the pushes under way whose joint's board is at its limit: planning looks at the rest state only."""
        now, saturated = tick.measurement.time, self._pepper.backend.truth.saturated
        if not saturated.any():
            return
        for number, push in enumerate(self.pushes):
            index = self._pepper.config.joint_index(push.joint)
            if push.onset <= now <= push.release and saturated[index]:
                self.pushes[number] = replace(push, saturated=True)

    def _plan(self, posture: FloatArray) -> PlannedPush:
        """A push of random joint, direction and size that a board can hold at rest."""
        scenario, rng = self._scenario, self._rng
        low, high = np.log(scenario.degrees)
        for _ in range(200):
            joint = scenario.joints[int(rng.integers(len(scenario.joints)))]
            where = scenario.push_points[joint]
            try:
                return plan_push(
                    self._pepper.controller.model,
                    self._pepper.config,
                    self._pepper.backend.truth,
                    joint=joint,
                    link=where.link,
                    point=np.array(where.xyz),
                    degrees=float(np.exp(rng.uniform(low, high))),
                    direction=int(rng.choice([-1, 1])),
                    posture=posture,
                    largest_load=scenario.largest_load,
                )
            except PushTooStrongError:
                continue
        raise ConfigError("scenarios/demo.yaml: no push of its sizes stays below saturation")


def _angle(robot: RobotConfig, joint: str, share: float, rng: np.random.Generator) -> float:
    """A random angle in the middle ``share`` of a joint's range [rad]."""
    limits = robot.joints[robot.joint_index(joint)]
    middle, half = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2
    return float(middle + share * half * rng.uniform(-1.0, 1.0))
