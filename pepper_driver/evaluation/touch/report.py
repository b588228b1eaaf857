"""The page of results of the judge of touch, with what the suites on the reference plants add to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pepper_driver.config import RobotConfig
from pepper_driver.config.files import make_folder, write_text
from pepper_driver.evaluation.figures import write_figures
from pepper_driver.evaluation.report import fits, table1
from pepper_driver.evaluation.results import EvaluationResult
from pepper_driver.evaluation.touch.ledger import Look, as_rows
from pepper_driver.evaluation.touch.page import SimulatedRobots, touch_page
from pepper_driver.evaluation.touch.recall import write_touch_pictures
from pepper_driver.evaluation.touch.summary_data import TouchSummary


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Origin of the results of a page.

    Attributes:
        command: That writes it.
        lines: More, a paragraph each.
        simulated: False for real robots.
        development: True for robots of the development split.
        ledger: Looks at the test split so far.
    """

    command: str
    lines: tuple[str, ...] = ()
    simulated: bool = True
    development: bool = False
    ledger: tuple[Look, ...] = field(default=())


def write_touch_report(
    summary: TouchSummary,
    path: Path,
    robot: RobotConfig,
    origin: Origin,
    reference: EvaluationResult | None = None,
    simulated_robots: SimulatedRobots | None = None,
) -> None:
    """Write the page; its pictures go into a folder of its name next to it.

    Args:
        summary: All results of touch.
        path: Of the page, Markdown.
        robot: Description of the robot.
        origin: Of the results.
        reference: Results of the suites on the reference plants, for Table I and the fit; None for none.
        simulated_robots: Those whose results are compared with recorded ones; None for none.

    Raises:
        OutputError: The page cannot be written.
        PlotError: A picture cannot be written.
    """
    folder = path.with_suffix("")
    make_folder(folder)
    drawn = write_touch_pictures(summary, folder, robot, simulated=origin.simulated)
    pictures = {f"{folder.name}/{name}": caption for name, caption in drawn.items()}
    kind = "simulated" if origin.simulated else "from recordings"
    but = (
        " but those that say *simulated*"
        if simulated_robots is not None and not origin.simulated
        else ""
    )
    parts: list[str] = [
        f"*All results here are {kind}{but}. `{origin.command}` wrote this page; do not edit it.*",
        "# Results of the contact observers",
        *origin.lines,
        *touch_page(
            summary,
            pictures,
            ledger=as_rows(origin.ledger),
            looks=len(origin.ledger),
            development=origin.development,
            simulated=origin.simulated,
            simulated_robots=simulated_robots,
        ),
        *_reference(reference, folder, robot),
    ]
    write_text(path, "\n\n".join(part for part in parts if part) + "\n")


def _reference(result: EvaluationResult | None, folder: Path, robot: RobotConfig) -> Sequence[str]:
    """Write Table I and the fit, with their figures."""
    if result is None:
        return ()
    captions = write_figures(result, folder, robot)
    pictures = {f"{folder.name}/{name}": caption for name, caption in captions.items()}
    return (*table1(result, pictures), *fits(result, pictures))
