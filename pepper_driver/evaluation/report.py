"""The page of results: every table and picture of an evaluation, written by the command and never by hand."""

from __future__ import annotations

from pathlib import Path

from pepper_driver.config import RobotConfig
from pepper_driver.config.files import write_text
from pepper_driver.evaluation.figures import write_figures
from pepper_driver.evaluation.markdown import number, table
from pepper_driver.evaluation.report_sections import (
    collision,
    fits,
    free,
    latency,
    missing,
    table1,
    thresholds,
    variants,
)
from pepper_driver.evaluation.results import Evaluation

_ABOUT = {
    "fusion": "the default observer: stick-slip twin, small tree, momentum channel, adaptive threshold",
    "paper-affine": "the paper's observer with affine trees (Eq. 12-13), median of 11, threshold 2.5 deg",
    "paper-cart": "the same with piecewise constant trees",
    "momentum": "momentum observer from the voltage law and the encoders (Eq. 10)",
    "oracle": "knows the plant: what the nominal robot would do untouched, simulated; paper's median and threshold",
}
_RULES = """\
Sizes of pushes are in equivalent degrees: largest torque on the joint divided by its stiffness K = Kp N Kt / R.
A push is felt when a contact is told on its limb from its onset until 0.15 s after its release. A false contact begins
outside of every push and of the 0.8 s after it, or on another limb. Pushes that saturate a motor board, pushes on
fingers or trunk and forces along a joint's axis are scored apart."""


def write_report(evaluation: Evaluation, path: Path, robot: RobotConfig, command: str) -> None:
    """Write the page and its pictures, which go into a folder of its name beside it.

    Args:
        evaluation: The results.
        path: Of the page, Markdown.
        robot: Its description.
        command: That makes this page.

    Raises:
        OutputError: The page cannot be written.
        PlotError: A picture cannot be written.
    """
    folder = path.with_suffix("")
    captions = write_figures(evaluation, folder, robot)
    pictures = {f"{folder.name}/{name}": caption for name, caption in captions.items()}
    write_text(path, page(evaluation, pictures, command))


def page(evaluation: Evaluation, pictures: dict[str, str], command: str) -> str:
    """The page as text; ``pictures`` has a caption for each path."""
    kind = "simulated" if evaluation.simulated else "from recordings"
    parts = [
        f"*All figures here are {kind}. `{command}` wrote this page; do not edit it.*",
        "# Results of the contact observers",
        *_provenance(evaluation),
        *table1(evaluation, pictures),
        *free(evaluation),
        *collision(evaluation, pictures),
        *fits(evaluation, pictures),
        *thresholds(evaluation),
        *variants(evaluation),
        *latency(evaluation),
        *missing(evaluation),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _provenance(evaluation: Evaluation) -> list[str]:
    rows = []
    for suite in evaluation.suites:
        takes = [take for take in evaluation.takes if take.suite == suite]
        hours = sum(take.seconds for take in takes) / 3600.0
        plants, seeds = ({str(getattr(t, key)) for t in takes} for key in ("plant", "seed"))
        rows.append((suite, str(len(takes)), number(hours), _names(plants), _names(seeds)))
    versions = ", ".join(f"{name} {number}" for name, number in evaluation.versions.items())
    about = [f"- `{mode}`: {_ABOUT[mode]}" for mode in evaluation.modes if mode in _ABOUT]
    only = (
        f" Only {evaluation.share:.0%} of each suite: a first look." if evaluation.share < 1 else ""
    )
    frozen = f" Suites as frozen in {evaluation.digest}." if evaluation.digest else ""
    return [
        f"Run of {evaluation.date} with {versions}. {evaluation.hours:.2f} hours in all.{frozen}{only}",
        table(("suite", "takes", "hours", "plants", "seeds"), rows),
        _RULES,
        "\n".join(about),
    ]


def _names(values: set[str]) -> str:
    """Up to a few names, or how many there are."""
    names = sorted(values)
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)})"
