"""Results of an evaluation: metrics of each observer by suite, with their sources."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pepper_driver.config import load_robot
from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.metrics import Metrics


@dataclass(frozen=True, kw_only=True)
class EpisodeInfo:
    """Description of an episode."""

    suite: str
    plant: str
    seed: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Failure:
    """An episode that gave no result, or an observer that gave none for it."""

    title: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class EvaluationResult:
    """All results.

    Attributes:
        suites: In the order in which they were asked for.
        modes: By name and suite.
        episodes: What was evaluated.
        failures: What was not.
        notes: Who did not take part, and why.
        traces: For pictures.
        date: Day of the run, UTC.
        versions: Of the packages that matter.
        digest: Of the frozen suites.
        fraction: Of the suites that was performed.
    """

    suites: tuple[str, ...]
    modes: dict[str, dict[str, Metrics]]
    episodes: tuple[EpisodeInfo, ...]
    failures: tuple[Failure, ...]
    notes: tuple[str, ...]
    traces: tuple[Trace, ...] = field(repr=False)
    date: str
    versions: dict[str, str]
    digest: str
    fraction: float = 1.0

    @property
    def hours(self) -> float:
        """Length of all episodes [h]."""
        return sum(episode.seconds for episode in self.episodes) / 3600.0

    def fit_loss(self, mode: str) -> dict[str, dict[str, float]]:
        """Loss of models on joints that they were not fitted to: suite, joint, points of the test fit.

        ``mirror``: to the other side's fit; ``types``: to the fit of the joint with a model of its own.
        """
        suites, robot = self.modes[mode], load_robot()
        other = {
            n: robot.joint_names[i]
            for n, (i, _) in zip(robot.joint_names, robot.mirror, strict=True)
        }
        own = (
            {joint: fit.test for joint, fit in suites["fit"].fit.items()} if "fit" in suites else {}
        )
        losses: dict[str, dict[str, float]] = {}
        for suite in ("mirror", "types"):
            for joint, fit in suites[suite].fit.items() if suite in suites else ():
                before = own.get(other[joint] if suite == "mirror" else joint)
                if before is not None and fit.test is not None:
                    losses.setdefault(suite, {})[joint] = before - fit.test
        return losses

    def as_json(self) -> dict[str, Any]:
        """``modes.<name>`` holds the metrics under ``suites``, each suite on its own, and the loss of the fit."""
        return {
            "simulated": True,
            "frozen": self.digest,
            "fraction": self.fraction,
            "date": self.date,
            "versions": self.versions,
            "suites": list(self.suites),
            "hours": self.hours,
            "plants": sorted({episode.plant for episode in self.episodes}),
            "seeds": list(dict.fromkeys(episode.seed for episode in self.episodes)),
            "failures": [{"title": f.title, "reason": f.reason} for f in self.failures],
            "notes": list(self.notes),
            "modes": {
                mode: {
                    "fit_loss": self.fit_loss(mode),
                    "suites": {suite: metrics.as_json() for suite, metrics in by_suite.items()},
                }
                for mode, by_suite in self.modes.items()
            },
        }
