"""The page of results that ``pepper evaluate`` writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from pepper_driver.config import RobotConfig
from pepper_driver.config.files import write_text
from pepper_driver.evaluation.evaluate import INTEGRAL
from pepper_driver.evaluation.figures import write_figures
from pepper_driver.evaluation.metrics import RECALL_BINS, Metrics
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
_OWN_SECTION = (
    "fit",
    "log",
    *(n + i for n in ("paper", "free", "collision") for i in ("", INTEGRAL)),
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

    def cells(metrics: Metrics) -> list[str]:
        counts = (metrics.table1.get(name) for name in PUBLISHED_TABLE)
        return [f"{c.fp} / {c.fn} / {c.tp}" if c else "-" for c in counts]

    published = ["published", *(" / ".join(map(str, c)) for c in PUBLISHED_TABLE.values())]

    def part(suite: str) -> str:
        rows = _rows(evaluation, suite, cells)
        return table(("observer", *PUBLISHED_TABLE), [published, *rows]) if rows else ""

    parts = _both(evaluation, "paper", part)
    if not parts:
        return []
    return section(
        "Table I of the paper",
        *parts,
        "False contacts / pushes missed / pushes detected. The first row is the paper's, on a real Pepper.",
        _picture(pictures, "figure3.png", "figure4.png"),
    )


def free(evaluation: EvaluationResult) -> list[str]:
    """Write the section on false contacts in free motion."""

    def cells(metrics: Metrics) -> list[str] | None:
        free, coverage = metrics.free_motion, metrics.coverage
        if free is None:
            return None
        return [
            number(free.hours),
            str(free.fp),
            number(free.fp_per_hour_upper95),
            str(coverage.joints),
            number(coverage.fraction, 3),
        ]

    header = (
        "observer",
        "hours",
        "false contacts",
        "per hour, 95 % bound",
        "joints observed",
        "of the time",
    )
    return section(
        "Free motion",
        *_both(evaluation, "free", lambda suite: table(header, _rows(evaluation, suite, cells))),
    )


def collision(evaluation: EvaluationResult, pictures: dict[str, str]) -> list[str]:
    """Write the section on the detection of random pushes, or of the touches of recordings."""
    suite = "log" if "log" in evaluation.suites else "collision"
    sizes = [
        f"{name.removesuffix('-')}{' and more' if name[-1] == '-' else ''} deg"
        for name in RECALL_BINS
    ]
    header = ("observer", *sizes, "all", "saturated", "along an axis", "trunk", "fingers")
    more = (
        "observer",
        "false contacts",
        "delay ms, median / p90",
        "direction",
        "joint right after 0 / 50 / 150 ms",
        "torque RMSE / K, deg",
        "torque R2",
        "rebounds reported (of)",
        "touches called rebounds (of)",
    )

    def part(suite: str) -> str:
        detected = table(header, _rows(evaluation, suite, _recall_cells))
        how = table(more, _rows(evaluation, suite, _quality_cells))
        return f"{detected}\n\n{how}" if detected else ""

    parts = _both(evaluation, suite, part)
    if not parts:
        return []
    return section(
        "Recordings" if suite == "log" else "Random pushes",
        *parts,
        "Fraction of pushes detected, and in brackets their number.",
        "Delays count from the onset of the force, for pushes of 3 deg and more; joints for pushes of 2 deg and more.",
        _picture(pictures, "recall.png"),
    )


def _recall_cells(metrics: Metrics) -> list[str]:
    groups = {
        **metrics.recall,
        "overall": metrics.recall_overall,
        "saturated": metrics.recall_saturated,
        "axis": metrics.recall_axis,
        "trunk": metrics.recall_trunk,
        "hands": metrics.recall_hands,
    }
    return [f"{number(value, 3)} ({metrics.recall_count[name]})" for name, value in groups.items()]


def _quality_cells(metrics: Metrics) -> list[str]:
    delay, torque, rebound = metrics.delay_ms, metrics.torque, metrics.rebound
    return [
        str(metrics.with_pushes.fp if metrics.with_pushes else "-"),
        f"{delay.median:.0f} / {delay.p90:.0f}" if delay else "-",
        number(metrics.direction, 3),
        " / ".join(number(value, 3) for value in metrics.isolation.values()),
        number(torque.rmse_over_k_deg if torque else None),
        number(torque.r2 if torque else None, 3),
        f"{number(rebound.recall, 3)} ({rebound.swings})" if rebound else "-",
        f"{number(rebound.mislabelled, 4)} ({rebound.touches})" if rebound else "-",
    ]


def fits(evaluation: EvaluationResult, pictures: dict[str, str]) -> list[str]:
    """NRMSE by joint: of models of the joints themselves, and of those copied from others."""
    return section(
        "Fit of the expected tracking error",
        _fit_table(evaluation, "fit"),
        _FIT,
        _picture(pictures, "figure2.png"),
        *(
            f"{title}\n\n{text}"
            for suite, title in _TRANSFERRED.items()
            if (text := _fit_table(evaluation, suite))
        ),
    )


def _fit_table(evaluation: EvaluationResult, suite: str) -> str:
    modes = {
        mode: by_suite[suite] for mode, by_suite in evaluation.modes.items() if suite in by_suite
    }
    last = "gap closed by fusion" if suite == "fit" else "points lost by fusion"
    figures: dict[str, float] = {}
    if "fusion" in modes:
        loss = evaluation.fit_loss("fusion").get(suite, {})
        figures = modes["fusion"].fit_gap_closed if suite == "fit" else loss
    rows = []
    for joint in dict.fromkeys(joint for metrics in modes.values() for joint in metrics.fit):
        fits = [metrics.fit.get(joint) for metrics in modes.values()]
        cells = [f"{number(f.estimation, 1)} / {number(f.test, 1)}" if f else "-" for f in fits]
        rows.append([joint, *cells, number(figures.get(joint))])
    return table(("joint", *modes, last), rows)


def thresholds(evaluation: EvaluationResult) -> list[str]:
    """Write the section on the smallest pushes that are detected."""

    def cells(metrics: Metrics) -> list[str] | None:
        spread = metrics.threshold_deg
        return None if spread is None else [number(v) for v in (spread.p05, spread.p50, spread.p95)]

    modes = {
        mode: by_suite["free"].threshold_nm
        for mode, by_suite in evaluation.modes.items()
        if "free" in by_suite and by_suite["free"].threshold_nm
    }
    joints = dict.fromkeys(joint for by_joint in modes.values() for joint in by_joint)
    return section(
        "Thresholds",
        table(
            ("observer", "5 %, deg", "median, deg", "95 %, deg"), _rows(evaluation, "free", cells)
        ),
        "Over time and joints of free motion. Per joint, median threshold times K in N m:",
        table(
            ("joint", *modes),
            ([joint, *(number(by.get(joint)) for by in modes.values())] for joint in joints),
        ),
    )


def variants(evaluation: EvaluationResult) -> list[str]:
    """Every suite that has no section of its own."""
    rows = []
    for suite in evaluation.suites:
        for mode, by_suite in evaluation.modes.items():
            if suite in _OWN_SECTION or suite not in by_suite:
                continue
            metrics = by_suite[suite]
            free, pushed, delay = metrics.free_motion, metrics.with_pushes, metrics.delay_ms
            tests = [fit.test for fit in metrics.fit.values() if fit.test is not None]
            rows.append(
                (
                    f"{suite}, {mode}",
                    f"{free.fp} in {free.hours:.2f} h (< {free.fp_per_hour_upper95:.1f}/h)"
                    if free
                    else "-",
                    f"{pushed.fp} in {pushed.hours:.2f} h (< {pushed.fp_per_hour_upper95:.1f}/h)"
                    if pushed
                    else "-",
                    f"{number(metrics.recall['2-3'], 3)} ({metrics.recall_count['2-3']})",
                    f"{number(metrics.recall['3-'], 3)} ({metrics.recall_count['3-']})",
                    f"{number(metrics.recall_trunk, 3)} ({metrics.recall_count['trunk']})",
                    number(delay.median if delay else None, 0),
                    number(metrics.isolation["150"], 3),
                    number(sum(tests) / len(tests) if tests else None, 1),
                )
            )
    header = (
        "suite, observer",
        "false, free motion",
        "false, with pushes",
        "detected 2-3 deg",
        "detected 3 deg and more",
        "detected on trunk",
        "delay ms",
        "joint right, 150 ms",
        "test fit, mean",
    )
    return section("Other robots and models", table(header, rows))


def latency(evaluation: EvaluationResult) -> list[str]:
    """Write the section on the time of a tick."""
    suite = "free" if "free" in evaluation.suites else evaluation.suites[0]

    def cells(metrics: Metrics) -> list[str]:
        return [number(metrics.latency_us.median, 0), number(metrics.latency_us.p99, 0)]

    return section(
        "Time for one tick",
        table(("observer", "median, us", "p99, us"), _rows(evaluation, suite, cells)),
        "Wall time of the observer for all joints, while other processes evaluate other episodes.",
    )


def missing(evaluation: EvaluationResult) -> list[str]:
    """Write the section on observers and episodes without a result."""
    lines = [*evaluation.notes, *(f"{f.title}: {f.reason}" for f in evaluation.failures)]
    return section("Not evaluated", "\n".join(f"- {line}" for line in lines))


def _both(evaluation: EvaluationResult, suite: str, part: Callable[[str], str]) -> list[str]:
    """Write a section for a suite, and one for its robots with the other kind of motor boards."""
    parts = []
    for name, kind in ((suite, ""), (suite + INTEGRAL, _INTEGRAL)):
        text = part(name) if name in evaluation.suites else ""
        if text:
            parts += [kind, text]
    return parts[1:] if parts and not parts[0] else parts


def _rows(
    evaluation: EvaluationResult, suite: str, cells: Callable[[Metrics], Sequence[str] | None]
) -> list[list[str]]:
    """Return a row for each observer that was evaluated in a suite and has something to say."""
    rows = []
    for mode, by_suite in evaluation.modes.items():
        row = cells(by_suite[suite]) if suite in by_suite else None
        if row is not None:
            rows.append([mode, *row])
    return rows


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
Sizes of pushes are in equivalent degrees: largest torque on the joint divided by its stiffness K = Kp N Kt / R.
A push is detected when a contact is reported on its limb from its onset until 0.15 s after its release. A false
contact begins outside of every push and of the 0.8 s after it, or on another limb. Pushes that saturate a motor board,
pushes on fingers or trunk and forces along a joint's axis are scored separately."""


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
    frozen = f" Suites as frozen in {evaluation.digest}." if evaluation.digest else ""
    return [
        f"Run of {evaluation.date} with {versions}. {evaluation.hours:.2f} hours in all.{frozen}{only}",
        table(("suite", "episodes", "hours", "plants", "seeds"), rows),
        _RULES,
        "\n".join(about),
    ]


def _names(values: set[str]) -> str:
    """Up to a few names, or how many there are."""
    names = sorted(values)
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)})"
