"""``pepper evaluate``: how well observers detect contacts, compared with baselines, on runs or recordings."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.cli.console import (
    ClusterOption,
    JsonOption,
    WorkersOption,
    check_outputs,
    chosen_workers,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.cli.evaluate_bundle import (
    bundles_of,
    evaluate_bundles,
    write_bundle_report,
)
from pepper_driver.cli.evaluate_split import (
    DEFAULT_FOLDER,
    SplitOptions,
    judge_split,
    print_summary,
)
from pepper_driver.config import ConfigError, RobotConfig, load_robot
from pepper_driver.config.cluster import Cluster
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.config.file_lock import lock_file, lock_folder
from pepper_driver.config.files import check_same, file_hash, make_folder
from pepper_driver.config.touch_suites import Split, load_touch_suites
from pepper_driver.config.workers import Workers
from pepper_driver.evaluation.episodes import DEFAULT_CACHE
from pepper_driver.evaluation.evaluate import QUICK, evaluate, suite_jobs
from pepper_driver.evaluation.metrics import Metrics
from pepper_driver.evaluation.observers_under_test import (
    DEFAULTS,
    ObserversUnderTest,
    contestants,
)
from pepper_driver.evaluation.report import number, write_report
from pepper_driver.evaluation.results import EvaluationResult
from pepper_driver.evaluation.touch.logs import judge_logs
from pepper_driver.evaluation.touch.records import LOG
from pepper_driver.evaluation.touch.report import Origin, write_touch_report
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.figure_style import check_plotting
from pepper_driver.log import read_log

ALL = "all"


def evaluate_command(
    suite: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="Suites to perform on single plants, such as fit or paper,fit; all for all. Without --suite and --log"
            " their names are printed.",
        ),
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(
            "--observer",
            metavar="A,B",
            help=f"Observers: {', '.join(DEFAULTS)}, or of other packages; by default all that have models.",
        ),
    ] = None,
    models: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Model file in place of the shipped one of its kind; may be given again.",
        ),
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    json_file: JsonOption = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also write a page with all tables and pictures, NAME.md."
        ),
    ] = None,
    cache: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Keep the runs here, and take those that are here; on a cluster, on the machine of each worker.",
        ),
    ] = DEFAULT_CACHE,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short runs: to try, not to quote.")
    ] = False,
    split: Annotated[
        Split | None,
        typer.Option(
            help="Judge robots of a population that people touch: those for development, as often as you like; those"
            " for tests, from a clean commit, each look a line in docs/results/ledger.csv. Suites: touch, free."
        ),
    ] = None,
    draws: Annotated[
        str | None,
        typer.Option(
            metavar="N-M",
            help="Robots of the development split, such as 0-7; by default those of config/touch_suites.yaml.",
        ),
    ] = None,
    note: Annotated[
        str,
        typer.Option(metavar="TEXT", help="Reason for a look at the test split, for the ledger."),
    ] = "",
    give_up: Annotated[
        bool,
        typer.Option(
            "--give-up", help="Begin a new look, and never finish the last one: its draws are lost."
        ),
    ] = False,
    last_look: Annotated[
        bool,
        typer.Option("--last-look", help="Show the last look at the test split, and take none."),
    ] = False,
    folder: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Keep models and takes of a split here, and take those that are here.",
        ),
    ] = DEFAULT_FOLDER,
    log: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Score a log instead: of any simulated run, or of 'pepper record --label'. Or the bundle of 'pepper"
            " first-hour', folder or archive, by its own models.",
        ),
    ] = None,
    more_logs: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE", help="More recordings, after --log.")
    ] = None,
) -> int:
    """Run observers on seeded simulated runs or on logs, and score their contacts."""
    console = make_console()
    logs = [*(log or []), *(more_logs or [])]
    if more_logs and not log:
        raise ConfigError(f"{more_logs[0]}: recordings come after --log")
    of_split = {
        "--draws": draws,
        "--note": note or None,
        "--give-up": give_up or None,
        "--last-look": last_look or None,
    }
    for name, value in of_split.items():
        if split is None and value is not None:
            raise ConfigError(f"{name} belongs to --split")
    if split is not None:
        if logs or models:
            given = "--log" if logs else "--models"
            raise ConfigError(
                f"{given} and --split exclude each other: a split identifies its robots"
            )
        return _evaluate_split(
            console,
            SplitOptions(
                split=split,
                draws=draws,
                parts=None if suite is None else _names(suite),
                observers=None if mode is None else _names(mode),
                quick=quick,
                note=note,
                give_up=give_up,
                last_look=last_look,
                folder=folder,
            ),
            workers=workers,
            cluster=cluster,
            json_file=json_file,
            report=report,
        )
    if logs and suite is None and bundles_of(logs):
        if models:
            raise ConfigError(
                "--models and a bundle exclude each other: a bundle has the models of its own robot"
            )
        return _evaluate_bundles(
            console,
            logs,
            None if mode is None else _names(mode),
            workers=workers,
            cluster=cluster,
            json_file=json_file,
            report=report,
        )
    robot = load_robot()
    frozen = None if logs else load_evaluation(robot)
    if bool(logs) == (suite is not None):
        known = "" if frozen is None else f"; suites: {', '.join((*frozen.names, ALL))}"
        raise ConfigError(f"give either --suite or --log{known}")
    for path in logs:  # in a worker this would be a failure of one recording
        read_log(path)
    check_outputs(json_file)
    if report is not None:
        _check_report(report)
    chosen = contestants(None if mode is None else _names(mode), models or [], robot)
    if frozen is None:
        return _evaluate_logs(
            console,
            logs,
            chosen,
            workers=workers,
            cluster=cluster,
            json_file=json_file,
            report=report,
        )
    suites = _names(suite or "")
    suites = frozen.names if ALL in suites else suites
    jobs = suite_jobs(frozen, suites, robot, quick=quick, cache=cache)
    with ExitStack() as opened:
        opened.enter_context(lock_folder(cache))
        if report is not None:
            opened.enter_context(lock_file(report))
        pool = opened.enter_context(chosen_workers(workers, cluster, console))
        if isinstance(pool, Cluster):
            _check_files(pool, cache, models or [])
        with make_progress(console, count=True) as progress:
            bar = progress.add_task("evaluating", total=len(jobs))
            result = evaluate(
                jobs,
                chosen,
                workers=pool,
                digest=frozen.digest,
                fraction=QUICK if quick else 1.0,
                progress=lambda done, _: progress.update(bar, completed=done),
            )
        _print(console, result)
        save_json(json_file, result.as_json(), console)
        if report is not None:
            options = (f" --observer {mode}" if mode else "") + (" --quick" if quick else "")
            command = f"pepper evaluate --suite {suite}{options} --report {report.name}"
            write_report(result, report, robot, command)
            console.print(f"report: {report}")
        return 1 if result.failures else 0


def _evaluate_logs(
    console: Console,
    logs: Sequence[Path],
    chosen: ObserversUnderTest,
    *,
    workers: int | None,
    cluster: str | None,
    json_file: Path | None,
    report: Path | None,
) -> int:
    """Score logs; print, save and write what was asked for."""
    chosen = replace(chosen, modes=chosen.of_suite(LOG))
    if not chosen.modes:
        raise ConfigError("no observer has models: " + "; ".join(chosen.notes))
    with chosen_workers(workers, cluster, console) as pool:
        if isinstance(pool, Cluster):
            _check_files(pool, None, [*(file.path for file in chosen.files), *logs])
        records, failures = judge_logs(logs, chosen, workers=pool)
    summary = summarise_touch(
        records, chosen.modes, load_robot(), suites=load_touch_suites(load_robot())
    )
    print_summary(console, summary, chosen.modes)
    for note in chosen.notes:
        console.print(note)
    for failure in failures:
        console.print(f"failed: {failure.path}: {failure.reason}")
    failed = [{"title": str(f.path), "reason": f.reason} for f in failures]
    save_json(json_file, {**summary.as_json(), "failures": failed}, console)
    if report is not None:
        names = " ".join(path.name for path in logs)
        command = f"pepper evaluate --log {names} --report {report.name}"
        simulated = all(read_log(path).truth is not None for path in logs)
        write_touch_report(
            summary, report, load_robot(), Origin(command=command, simulated=simulated)
        )
        console.print(f"report: {report}")
    return 1 if failures else 0


def _evaluate_bundles(
    console: Console,
    paths: Sequence[Path],
    observers: Sequence[str] | None,
    *,
    workers: int | None,
    cluster: str | None,
    json_file: Path | None,
    report: Path | None,
) -> int:
    """Judge bundles of a first hour; print, save and write what was asked for."""
    check_outputs(json_file)
    if report is not None:
        _check_report(report)
    with chosen_workers(workers, cluster, console) as pool:
        found = evaluate_bundles(console, paths, observers, pool)
    save_json(json_file, found.as_json(), console)
    if report is not None:
        with lock_file(report):
            write_bundle_report(console, found, report)
    return 1 if found.failures else 0


def _evaluate_split(
    console: Console,
    options: SplitOptions,
    *,
    workers: int | None,
    cluster: str | None,
    json_file: Path | None,
    report: Path | None,
) -> int:
    """Judge the robots of a split; print, save and write what was asked for."""
    check_outputs(json_file)
    if report is not None:
        _check_report(report)
    with chosen_workers(workers, cluster, console) as pool:
        judged = judge_split(options, pool, console)
        print_summary(console, judged.summary, judged.observers)
        save_json(json_file, judged.as_json(), console)
        if report is not None:
            robot = load_robot()
            # Not before: a look is from a clean commit, and a lock next to the page is none of it.
            with lock_file(report):
                reference = _reference(robot, pool, console)
                write_touch_report(judged.summary, report, robot, judged.origin(report), reference)
            console.print(f"report: {report}")
    return 1 if judged.failed else 0


def _reference(robot: RobotConfig, pool: Workers, console: Console) -> EvaluationResult:
    """Evaluate all observers on the suites of the reference plants."""
    frozen = load_evaluation(robot)
    jobs = suite_jobs(frozen, frozen.names, robot, cache=DEFAULT_CACHE)
    chosen = contestants(None, [], robot)
    with make_progress(console, count=True) as progress:
        bar = progress.add_task("evaluating Table I and fit", total=len(jobs))
        return evaluate(
            jobs,
            chosen,
            workers=pool,
            digest=frozen.digest,
            progress=lambda done, _: progress.update(bar, completed=done),
        )


def _check_report(report: Path) -> None:
    """See that a page can be written, before the work is done rather than after."""
    if report.suffix != ".md":
        raise ConfigError(f"{report}: a report is Markdown and ends in .md")
    check_plotting("the pictures of a report")
    make_folder(report.parent)
    check_outputs(report)


def _check_files(cluster: Cluster, cache: Path | None, files: Sequence[Path]) -> None:
    """See that each worker can keep episodes, and reads the same files as this process."""
    if cache is not None:
        cluster.check(partial(make_folder, cache), "give '--cache' a folder that each can write")
    hashes = {path: file_hash(path) for path in files}
    cluster.check(partial(check_same, hashes), "put it into a folder that all machines share")


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in text.split(",")))


def _print(console: Console, result: EvaluationResult) -> None:
    """Print a table for each suite, with a column for each observer; missing results below."""
    for suite in result.suites:
        columns = {
            m: _cells(suites[suite]) for m, suites in result.modes.items() if suite in suites
        }
        if not columns:
            continue
        hours = (
            sum(episode.seconds for episode in result.episodes if episode.suite == suite) / 3600.0
        )
        table = Table(title=f"{suite}: {hours:.2f} hours in simulation", title_justify="left")
        table.add_column("")
        for mode in columns:
            table.add_column(mode, justify="right")
        for name in dict.fromkeys(name for cells in columns.values() for name in cells):
            row = [cells.get(name, "-") for cells in columns.values()]
            if any(cell != "-" for cell in row):
                table.add_row(name, *row)
        console.print(table)
    for note in result.notes:
        console.print(note)
    for failure in result.failures:
        console.print(f"failed: {failure.title}: {failure.reason}")


def _cells(metrics: Metrics) -> dict[str, str]:
    """Results by name; a dash where a result is not available."""
    tests = [fit.test for fit in metrics.fit.values() if fit.test is not None]
    estimations = [fit.estimation for fit in metrics.fit.values() if fit.estimation is not None]
    return {
        **{f"{name}, FP/FN/TP": f"{c.fp}/{c.fn}/{c.tp}" for name, c in metrics.table1.items()},
        "fit %, estimation": number(_mean(estimations), 1),
        "fit %, test": number(_mean(tests), 1),
    }


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
