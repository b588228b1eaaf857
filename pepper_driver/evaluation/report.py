"""The page of results that ``pepper evaluate --suite`` writes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from pepper_driver.config import RobotConfig
from pepper_driver.config.files import write_text
from pepper_driver.evaluation.evaluate import INTEGRAL
from pepper_driver.evaluation.figures import write_figures
from pepper_driver.evaluation.metrics import Metrics
from pepper_driver.evaluation.results import EvaluationResult


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; all columns but the first are numbers."""
    rows = list(rows)
    if not rows:
        return ""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def number(value: float | None, digits: int = 2) -> str:
    """Return a formatted number, or a dash where it is not available."""
    return "-" if value is None else f"{value:.{digits}f}"


def section(title: str, *parts: str) -> list[str]:
    """Return a section with its title; nothing at all when its first part is empty."""
    return [f"## {title}", *parts] if parts and parts[0] else []


PUBLISHED_TABLE = {
    "LSRoll": (2, 2, 18),
    "RERoll": (0, 3, 19),
    "RSRoll": (0, 3, 18),
    "total": (2, 8, 55),
}
"""FP, FN, TP on a real Pepper: Table I of the paper."""
_INTEGRAL = (
    "Boards with an integral part over a softer PD, the other reading of what real Peppers do:"
)
_TRANSFERRED = {
    "mirror": "Suite `mirror`: models of the left side on the right. Points lost to the left joint:",
    "types": "Suite `types`: one model for all joints with the same type of motor. Points lost to a model of its own:",
}
_FIT = """\
NRMSE in per cent, 100 is perfect: mean over the estimation runs (task stiffness 2 to 5) / test runs (9). The paper
reports 77.3 / 81.1 for a real Pepper. The gap is that from `paper-affine` to `oracle` on the test runs."""


def table1(evaluation: EvaluationResult, pictures: dict[str, str]) -> list[str]:
    """Comparison with the paper's own results."""
    header = ("observer", *PUBLISHED_TABLE)
    published = ["published", *(" / ".join(map(str, c)) for c in PUBLISHED_TABLE.values())]

    def part(suite: str, about: str = "") -> str:
        rows = [
            [mode, *_table1_cells(by_suite[suite])]
            for mode, by_suite in evaluation.modes.items()
            if suite in by_suite
        ]
        return "\n\n".join(filter(None, (about, table(header, [published, *rows])))) if rows else ""

    parts = list(filter(None, (part("paper"), part("paper" + INTEGRAL, _INTEGRAL))))
    if not parts:
        return []
    return section(
        "Table I of the paper",
        *parts,
        "False contacts / pushes missed / pushes detected. The first row is the paper's, on a real Pepper.",
        _picture(pictures, "figure3.png", "figure4.png"),
    )


def _table1_cells(metrics: Metrics) -> list[str]:
    counts = (metrics.table1.get(name) for name in PUBLISHED_TABLE)
    return [f"{c.fp} / {c.fn} / {c.tp}" if c else "-" for c in counts]


def fits(evaluation: EvaluationResult, pictures: dict[str, str]) -> list[str]:
    """NRMSE by joint: of models of the joints themselves, and of those copied from others."""
    own = _fit_table(evaluation, "fit")
    transferred = [
        f"{title}\n\n{text}"
        for suite, title in _TRANSFERRED.items()
        if (text := _fit_table(evaluation, suite))
    ]
    if not own and not transferred:
        return []
    return section(
        "Fit of the expected tracking error",
        _FIT,
        own,
        _picture(pictures, "figure2.png"),
        *transferred,
    )


def _fit_table(evaluation: EvaluationResult, suite: str) -> str:
    modes = {
        mode: by_suite[suite] for mode, by_suite in evaluation.modes.items() if suite in by_suite
    }
    last = "gap closed by fusion" if suite == "fit" else "points lost by fusion"
    results: dict[str, float] = {}
    if "fusion" in modes:
        loss = evaluation.fit_loss("fusion").get(suite, {})
        results = modes["fusion"].fit_gap_closed if suite == "fit" else loss
    rows = []
    for joint in dict.fromkeys(joint for metrics in modes.values() for joint in metrics.fit):
        fits = [metrics.fit.get(joint) for metrics in modes.values()]
        cells = [f"{number(f.estimation, 1)} / {number(f.test, 1)}" if f else "-" for f in fits]
        rows.append([joint, *cells, number(results.get(joint))])
    return table(("joint", *modes, last), rows)


def missing(evaluation: EvaluationResult) -> list[str]:
    """Write the section on observers and episodes without a result."""
    lines = [*evaluation.notes, *(f"{f.title}: {f.reason}" for f in evaluation.failures)]
    return section("Not evaluated", "\n".join(f"- {line}" for line in lines))


def _picture(pictures: dict[str, str], *names: str) -> str:
    return "\n\n".join(
        f"![{Path(path).stem}]({path})\n\n{caption}"
        for path, caption in pictures.items()
        if Path(path).name in names
    )


_ABOUT = {
    "fusion": "the default observer: stick-slip model, small tree, momentum residual, adaptive threshold",
    "paper-affine": "the paper's observer with affine trees (Eq. 12-13), median of 11, threshold 2.5 deg",
    "paper-cart": "the same with piecewise constant trees",
    "momentum": "momentum observer from the voltage law and the encoders (Eq. 10)",
    "oracle": "has the true plant: simulation of the untouched robot; paper's median and threshold",
}
_RULES = """\
A push is detected when a contact is reported on its limb from its onset until 0.15 s after its release. A false
contact begins outside of every push and of the 0.8 s after it, or on another limb."""


def write_report(
    evaluation: EvaluationResult, path: Path, robot: RobotConfig, command: str
) -> None:
    """Write the page and its figures, which go into a folder of its name next to it.

    Args:
        evaluation: The results.
        path: Of the page, Markdown.
        robot: Its description.
        command: That makes this page.

    Raises:
        OutputError: The page cannot be written.
        PlotError: A figure cannot be written.
    """
    folder = path.with_suffix("")
    captions = write_figures(evaluation, folder, robot)
    pictures = {f"{folder.name}/{name}": caption for name, caption in captions.items()}
    write_text(path, page(evaluation, pictures, command))


def page(evaluation: EvaluationResult, pictures: dict[str, str], command: str) -> str:
    """Return the page as text; ``pictures`` has a caption for each path."""
    parts = [
        f"*All results here are simulated. `{command}` wrote this page; do not edit it.*",
        "# Results of the contact observers",
        *_provenance(evaluation),
        *table1(evaluation, pictures),
        *fits(evaluation, pictures),
        *missing(evaluation),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _provenance(evaluation: EvaluationResult) -> list[str]:
    rows = []
    for suite in evaluation.suites:
        episodes = [episode for episode in evaluation.episodes if episode.suite == suite]
        hours = sum(episode.seconds for episode in episodes) / 3600.0
        plants, seeds = ({str(getattr(t, key)) for t in episodes} for key in ("plant", "seed"))
        rows.append((suite, str(len(episodes)), number(hours), _names(plants), _names(seeds)))
    versions = ", ".join(f"{name} {number}" for name, number in evaluation.versions.items())
    about = [f"- `{mode}`: {_ABOUT[mode]}" for mode in evaluation.modes if mode in _ABOUT]
    only = (
        f" Only {evaluation.fraction:.0%} of each suite: a quick check."
        if evaluation.fraction < 1
        else ""
    )
    return [
        f"Run of {evaluation.date} with {versions}. {evaluation.hours:.2f} hours in all. Suites as "
        f"frozen in {evaluation.digest}.{only}",
        table(("suite", "episodes", "hours", "plants", "seeds"), rows),
        _RULES,
        "\n".join(about),
    ]


def _names(values: set[str]) -> str:
    """Up to a few names, or how many there are."""
    names = sorted(values)
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)})"
