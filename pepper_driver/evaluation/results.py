"""Results of an evaluation: metrics of each observer by suite, with their sources."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from pepper_driver.config import load_observer_settings, load_robot
from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.metrics import Metrics

_HOME = {
    "fit": ("fit", "fit_gap_closed"),
    "paper": ("table1",),
    "free": ("free_motion", "threshold_deg", "threshold_nm", "latency_us", "coverage"),
}
"""The suite that defines a metric, where it was evaluated; for other metrics it is ``collision``."""
_MAIN = "collision"


@dataclass(frozen=True, kw_only=True)
class EpisodeInfo:
    """Description of an episode."""

    suite: str
    experiment: str
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
        digest: Of the frozen suites; None for recordings.
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
    digest: str | None = None
    fraction: float = 1.0

    @property
    def simulated(self) -> bool:
        """True if the episodes come from simulation, false if from recordings."""
        return self.digest is not None

    @property
    def hours(self) -> float:
        """Length of all episodes [h]."""
        return sum(episode.seconds for episode in self.episodes) / 3600.0

    def suite_of(self, key: str, mode: str) -> str:
        """Return the suite that defines a metric: its own one, else the first that has it."""
        by_suite = self.modes[mode]
        home = next((suite for suite, keys in _HOME.items() if key in keys), _MAIN)
        order = [suite for suite in (home, *by_suite) if suite in by_suite]
        return next((s for s in order if not _empty(by_suite[s].as_json()[key])), order[0])

    def headline(self, mode: str) -> dict[str, Any]:
        """Return the metrics of a mode, each from its :meth:`suite_of`, which ``suite_of`` names."""
        by_suite = {suite: metrics.as_json() for suite, metrics in self.modes[mode].items()}
        keys = [field.name for field in fields(Metrics)]
        origin = {key: self.suite_of(key, mode) for key in keys}
        return {**{key: by_suite[origin[key]][key] for key in keys}, "suite_of": origin}

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
        """``modes.<name>`` holds the headline and, under ``suites``, each suite on its own.

        ``paper`` is the paper's observer with the trees of the settings, under that name too.
        """
        names = {mode: mode for mode in self.modes}
        tree = f"paper-{load_observer_settings().tree}"
        if tree in names:
            names = {"paper": tree, **names}
        return {
            "simulated": self.simulated,
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
                name: {
                    **self.headline(mode),
                    "fit_loss": self.fit_loss(mode),
                    "suites": {suite: m.as_json() for suite, m in self.modes[mode].items()},
                }
                for name, mode in names.items()
            },
        }


def _empty(value: object) -> bool:
    """Return true if a metric holds no data."""
    if isinstance(value, dict):
        return all(_empty(part) or part == 0 for part in value.values())
    return value is None
