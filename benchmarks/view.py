"""The view in a browser: what it costs the robot's program, how smooth it is, and how soon it is there.

A moving robot ticks in real time with controller, observer and log: alone; streamed, with the page and a second client
of the stream; and viewed, with a browser at niceness 10 as well; in turn, as often as --rounds says. Of each: ticks
missed, and the time of a tick without the robot; of the page: rows a second that the client gets, processor time and
memory. Then the time from a command to the first picture in a browser: of a robot, three times and once more before
them, and of a log (--log, or one that is made here and lasts as long as --hours says).

The browser is Debian's Chromium, headless; it draws by software, and takes most of two processors itself.

Run on an idle machine: python benchmarks/view.py --seconds 30 --json view.json
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]
from rich.console import Console
from rich.table import Table

from pepper_driver import Hold, Pepper
from pepper_driver.config.files import write_json
from pepper_driver.telemetry import Kind, TelemetryClient
from pepper_driver.viewer.view import View

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support.browsers import open_browser, text_of, wait_until

NICENESS = 10
TOKEN = "benchmark"
STEP = 4.0  # [s] of a motion
STARTS = 3
KINDS = ("alone", "streamed", "viewed")
LONG_STEP = 10.0  # [s] between two motions of the long log


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    parser.add_argument("--rounds", type=int, default=2, help="runs of each kind")
    parser.add_argument("--log", type=Path, help="log whose opening is timed")
    parser.add_argument("--hours", type=float, default=1.0, help="of a log that is made for it")
    parser.add_argument("--json", type=Path, help="file for the results")
    arguments = parser.parse_args()
    console = Console()
    results: dict[str, Any] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        for _ in range(arguments.rounds):
            for kind in KINDS:
                results[kind].append(run(kind, arguments.seconds, path))
                console.print(f"{kind}: {results[kind][-1]}")
        results["first_picture"] = [first_picture(["view"]) for _ in range(STARTS + 1)][1:]
        console.print(f"first picture: {results['first_picture']}")
        log = arguments.log
        if log is None:
            log = Path(folder) / "long.mcap"
            make_log(log, 3600.0 * arguments.hours)
        results["log"] = {
            "megabytes": log.stat().st_size / 1e6,
            "first_picture": [first_picture(["view", str(log)]) for _ in range(STARTS)],
        }
    console.print(table(results))
    if arguments.json is not None:
        write_json(arguments.json, results)


def run(kind: str, seconds: float, log: Path) -> dict[str, Any]:
    """Return the results of a robot that moves in real time, of one of KINDS."""
    pepper = Pepper("mujoco", real_time=True, log=log, reflexes=[Hold()])
    with ExitStack() as stack:
        page: Watched | None = None
        if kind != "alone":
            view = stack.enter_context(View(token=TOKEN))
            page = stack.enter_context(watched(view))
            view.show(pepper)
        browser = stack.enter_context(open_browser(NICENESS)) if kind == "viewed" else None
        stack.enter_context(pepper)
        pepper.set_posture({"LShoulderPitch": 0.6, "LElbowRoll": -0.9}, duration=2.0)
        pepper.run(2.0)
        if browser is not None:
            browser.get(view.address)
            wait_until(lambda: "touched:" in text_of(browser))
            pepper.run(5.0)
        pepper.clear_statistics()
        if page is not None:
            page.begin()
        for number in range(round(seconds / STEP)):
            goal = 0.6 + 0.3 * (number % 2)
            pepper.set_posture({"LShoulderPitch": goal, "HeadYaw": goal - 0.6}, duration=2.0)
            pepper.run(STEP)
        found = pepper.statistics
        results = {
            "ticks": found.ticks,
            "missed": found.missed,
            "tick_us": found.tick.median,
            "tick_p99_us": found.tick.p99,
        }
        return results if page is None else results | page.results()


class Watched:
    """Counts rows that a client of the stream gets, and what the page costs.

    Args:
        view: With its page.
    """

    def __init__(self, view: View) -> None:
        self._telemetry = view._telemetry
        self._page = psutil.Process(view._process._process.pid)
        self._rows = 0
        self._closing = False

    def listen(self) -> None:
        """Count until it is closed."""
        with TelemetryClient(self._telemetry.address, self._telemetry.token) as client:
            while not self._closing:
                message = client.receive(0.1)
                self._rows += message is not None and message.kind is Kind.TICK

    def begin(self) -> None:
        """Count from now on."""
        self._rows, self._begin = 0, time.perf_counter()
        self._cpu = sum(self._page.cpu_times()[:2])

    def results(self) -> dict[str, float]:
        """Return rows a second, processor time of the page as a ratio, and its memory [MB]."""
        passed = time.perf_counter() - self._begin
        return {
            "rows_per_s": self._rows / passed,
            "page_cpu": (sum(self._page.cpu_times()[:2]) - self._cpu) / passed,
            "page_mb": self._page.memory_info().rss / 1e6,
        }

    def close(self) -> None:
        """End."""
        self._closing = True


@contextmanager
def watched(view: View) -> Iterator[Watched]:
    """Count what a view streams as long as the block is open."""
    found = Watched(view)
    thread = threading.Thread(target=found.listen)
    thread.start()
    try:
        yield found
    finally:
        found.close()
        thread.join()


def first_picture(command: list[str]) -> float:
    """Return the time from a command to the state of the robot on its page [s]; the browser waits for the address."""
    with open_browser(0) as browser:
        browser.get("about:blank")
        time.sleep(2.0)
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "pepper_driver", *command, "--no-open"],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        try:
            assert process.stdout is not None
            browser.get(process.stdout.readline().split()[1])
            wait_until(lambda: "touched:" in text_of(browser))
            return time.perf_counter() - begin
        finally:
            process.terminate()
            process.wait()


def make_log(path: Path, seconds: float) -> None:
    """Write the log of a robot that moves its arms from time to time."""
    with Pepper("mujoco", log=path) as pepper:
        for number in range(round(seconds / LONG_STEP)):
            posture = {"LShoulderPitch": 0.6 + 0.5 * (number % 2), "LElbowRoll": -0.9}
            pepper.set_posture(posture, duration=2.0)
            pepper.run(LONG_STEP)


def table(results: dict[str, Any]) -> Table:
    """Return a table of the results."""
    shown = Table("", *KINDS)

    def row(title: str, key: str, form: str = "{:.0f}") -> None:
        cells = [
            ", ".join(form.format(one[key]) for one in results[kind] if key in one) or "-"
            for kind in KINDS
        ]
        shown.add_row(title, *cells)

    row("ticks", "ticks")
    row("missed", "missed")
    row("tick without the robot, median [us]", "tick_us")
    row("its p99 [us]", "tick_p99_us")
    medians = [statistics.median(one["tick_us"] for one in results[kind]) for kind in KINDS]
    shown.add_row("ratio of medians", *(f"{median / medians[0]:.3f}" for median in medians))
    row("rows a second", "rows_per_s", "{:.1f}")
    row("processor time of the page", "page_cpu", "{:.2f}")
    row("memory of the page [MB]", "page_mb")
    shown.add_row("first picture [s]", "", "", f"{statistics.median(results['first_picture']):.2f}")
    title = f"first picture of a log of {results['log']['megabytes']:.0f} MB [s]"
    shown.add_row(title, "", "", f"{statistics.median(results['log']['first_picture']):.2f}")
    return shown


if __name__ == "__main__":
    main()
