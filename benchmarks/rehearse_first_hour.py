"""Rehearses a first hour against the stand-in, with all that may end it early, and a program in place of the person.

Follows the steps of docs/first_robot.md: answers the questions of `pepper first-hour` in a terminal, pushes the robot
where it asks for touches and presses its head meanwhile, and ends the command early in every way the page names: an
operator who leaves, the button on the chest, the space bar, the cable, a robot that is sent to rest, a hot motor, an
empty battery, a killed program, Ctrl-C. After each it calls the same command again, and sees that nothing was lost.
Then it sees that another plan is refused.
Steps are short; --full takes the shipped plan, and an hour. The machine must have two free processors: ticks and cycles
of the robot are by the wall clock. Results are of the simulated robot.
Run: python benchmarks/rehearse_first_hour.py --plant recorded --network wifi --json rehearsal.json
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.naoqi.qi_library import Proxy, load_qi
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from pepper_driver.config.first_hour import load_first_hour
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.touch_prompts import load_touch_prompts
from pepper_driver.first_hour.bundle import ARCHIVE, open_bundle
from pepper_driver.first_hour.state import STATE, load_state
from pepper_driver.log import read_log

PAGE = Path(__file__).parent.parent / "docs" / "first_robot.md"
ANSWER = 20.0
"""[s] for which a question waits in a short hour."""

LINE_TIMEOUT = 900.0
"""[s] for a line of the command."""

TRIES = 20
"""Calls of the command for one trouble."""

FORCE, PRESS = 15.0, 1.5
"""[N] and [s] of a touch."""


# -- a short hour -------------------------------------------------------------------------------------------------


def short_plan(folder: Path) -> Path:
    """Write the shipped plan with fewer joints, sweeps, goals and touches; returns its file."""

    def shortened(name: str, change: Callable[[dict[str, Any]], None]) -> str:
        content = read_yaml(package_file("experiments", f"{name}.yaml"))
        change(content["steps"][0])
        content["name"] = f"short_{name}"
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(content))
        return str(path)

    settings = read_yaml(package_file("first_hour.yaml"))
    settings["experiment"] = shortened(
        settings["experiment"],
        lambda step: step["sweeps"].update(
            joints=["LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll"],
            estimation_stiffness=[3.5],
            sweeps=1,
            setpoints=2,
            dwell=[0.8, 1.6],
        ),
    )
    for key in ("calibration", "free"):
        settings[key] = shortened(settings[key], lambda step: step["setpoints"].update(count=8))
    prompts = read_yaml(package_file("touch_prompts.yaml"))
    prompts |= {"rest": 3.0, "time": 5.0, "touches": prompts["touches"][0:24:6]}
    path = folder / "prompts.yaml"
    path.write_text(yaml.safe_dump(prompts))
    settings |= {"prompts": str(path), "rest": 15.0, "answer": ANSWER}
    plan = folder / "first_hour.yaml"
    plan.write_text(yaml.safe_dump(settings))
    return plan


def other_plan(plan: Path, folder: Path) -> Path:
    """Write a plan in which the robot stands for another time; returns its file."""
    settings = read_yaml(plan)
    path = folder / "other_plan.yaml"
    path.write_text(yaml.safe_dump(settings | {"rest": settings["rest"] + 1.0}))
    return path


# -- the command, in a terminal -----------------------------------------------------------------------------------


class Command:
    """`pepper first-hour` in a process and a terminal of its own."""

    def __init__(self, arguments: Sequence[str]) -> None:
        ours, theirs = pty.openpty()
        self._terminal = ours
        self.process = subprocess.Popen(
            [sys.executable, "-m", "pepper_driver", "first-hour", *arguments],
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
        os.close(theirs)
        self.lines: list[str] = []
        self._seen = 0
        self._news = threading.Condition()
        self._over = False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._news:
                self.lines.append(line.rstrip())
                self._news.notify_all()
        with self._news:
            self._over = True
            self._news.notify_all()

    def next_line(self) -> str | None:
        """Return the next line; None at the end."""
        with self._news:
            if not self._news.wait_for(
                lambda: self._seen < len(self.lines) or self._over, LINE_TIMEOUT
            ):
                raise SystemExit(f"no line for {LINE_TIMEOUT:g} s; the last: {self.lines[-3:]}")
            if self._seen == len(self.lines):
                return None
            self._seen += 1
            return self.lines[self._seen - 1]

    def type(self, text: str) -> None:
        """Type at its terminal."""
        with suppress(OSError):  # it has ended
            os.write(self._terminal, text.encode())

    def end(self) -> int:
        """Wait for its end; returns its exit code."""
        code = self.process.wait(LINE_TIMEOUT)
        os.close(self._terminal)
        return code


# -- what ends it early -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """Something that ends the command early.

    Attributes:
        name: For the table.
        step: In which it comes.
        after: Line of the command after which it comes; empty where it comes before the call.
        cause: Makes it; None for an operator who does not answer.
        delay: Between that line and it [s].
        code: Exit code of the command.
        words: Pattern of the line in which it says why it ended.
        refused: What the next call must say, before the cause is removed; empty for none.
        beforehand: Fault of the stand-in before the call; empty for none.
    """

    name: str
    step: str
    after: str
    cause: Callable[[StandIn, Command], None] | None
    code: int
    words: str
    delay: float = 3.0
    refused: str = ""
    beforehand: str = ""


def fault(text: str) -> Callable[[StandIn, Command], None]:
    """Return what injects a fault."""
    return lambda stand_in, command: stand_in.set_fault(text)


def rest(stand_in: StandIn, command: Command) -> None:
    """Have another program send the robot to rest."""
    with service_of(stand_in, "ALMotion") as motion:
        motion.rest()


QUESTION = r"^Begin step '{}'"

TROUBLES = (
    Trouble(
        name="an operator leaves",
        step="doctor",
        after=QUESTION.format("doctor"),
        cause=None,
        code=2,
        words="no answer for",
    ),
    Trouble(
        name="button on the chest",
        step="measure",
        after=r"^measure_friction-1",
        cause=fault("press:ChestBoard/Button,seconds=1"),
        code=1,
        words="button",
    ),
    Trouble(
        name="space bar",
        step="measure",
        after=r"^measure_(friction|speed)-1",
        cause=lambda stand_in, command: command.type(" "),
        code=1,
        words="space bar",
    ),
    Trouble(
        name="cable",
        step="identify",
        after=r"^LShoulderPitch-",
        cause=fault("cut:seconds=3"),
        code=1,
        words="connection|connected|sample",
    ),
    Trouble(
        name="robot is sent to rest",
        step="rest",
        after=QUESTION.format("rest"),
        cause=rest,
        code=1,
        words="stiffness|commands",
        delay=12.0,
    ),
    Trouble(
        name="hot motor",
        step="free",
        after=QUESTION.format("free"),
        cause=fault("hot:LShoulderPitch,80"),
        code=1,
        words="LShoulderPitch",
        delay=12.0,
        refused="cool",
    ),
    Trouble(
        name="empty battery",
        step="free",
        after="",
        cause=None,
        beforehand="value:Battery/Charge/Sensor/Value,0.15",
        code=1,
        words="charge it",
    ),
    Trouble(
        name="program killed",
        step="free",
        after=QUESTION.format("free"),
        cause=lambda stand_in, command: command.process.kill(),
        code=-signal.SIGKILL,
        words="",
        delay=12.0,
    ),
    Trouble(
        name="Ctrl-C",
        step="touches",
        after=r"^ +1\. ",
        cause=lambda stand_in, command: command.process.send_signal(signal.SIGINT),
        code=130,
        words="interrupted",
    ),
    Trouble(
        name="an operator leaves",
        step="touches",
        after=QUESTION.format("touches"),
        cause=None,
        code=1,
        words="no answer for",
    ),
)


@contextmanager
def service_of(stand_in: StandIn, name: str) -> Iterator[Proxy]:
    """Give a service over a connection of its own."""
    session = load_qi().Session()
    session.connect(stand_in.url)
    try:
        yield session.service(name)
    finally:
        session.close()


# -- a rehearsal --------------------------------------------------------------------------------------------------


@dataclass
class Rehearsal:
    """A rehearsal that is under way.

    Attributes:
        stand_in: The robot.
        folder: Of the hour.
        arguments: Of the command.
        prompts: Links that are to be touched, in their order.
        begun: Steps that were begun, in their order.
        ends: By trouble: exit code and last line.
        problems: What went otherwise than it should.
        other_ends: Last lines of calls that ended before their trouble came: on a busy machine samples come late.
        seconds: Time of the calls by step [s].
    """

    stand_in: StandIn
    folder: Path
    arguments: list[str]
    prompts: Sequence[str]
    begun: list[str] = field(default_factory=list)
    ends: list[dict[str, Any]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    other_ends: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def call(self, trouble: Trouble | None) -> tuple[int, list[str]]:
        """Call the command until trouble ends it, or its last step; again where something else ended it."""
        for _ in range(TRIES):
            code, lines, came = self._call_once(trouble)
            if came or code == 0:
                break
            print(f"ended by something else, called again: {lines[-1]}", flush=True)
            self.other_ends.append(lines[-1])
            time.sleep(2.0)
            with service_of(self.stand_in, "ALMotion") as motion:
                motion.wakeUp()
        return code, lines

    def _call_once(self, trouble: Trouble | None) -> tuple[int, list[str], bool]:
        """Call the command; the last part is True once trouble came, and at an end that was to come without any."""
        command = Command(self.arguments)
        step, since, caused = "", time.monotonic(), trouble is None
        while (line := command.next_line()) is not None:
            print(f"    {line}", flush=True)
            if found := re.match(r"Begin step '(\w+)'", line):
                step, since = found[1], time.monotonic()
                if step not in self.begun:
                    self.begun.append(step)
            if trouble is not None and not caused and step == trouble.step:
                caused = bool(trouble.after) and re.search(trouble.after, line) is not None
                if caused and trouble.cause is None:
                    continue  # the operator has left
                if caused and trouble.cause is not None:
                    cause = (self.stand_in, command)
                    threading.Timer(trouble.delay, trouble.cause, cause).start()
            if "[y/N]" in line:
                time.sleep(0.3)  # a person reads it
                command.type("y\n")
            if found := re.match(r" *(\d+)\. ", line):
                threading.Timer(1.0, self._touch, (int(found[1]) - 1,)).start()
            if step:
                self.seconds[step] = time.monotonic() - since
        code = command.end()
        refused = trouble is not None and not trouble.after
        return code, command.lines, refused or (trouble is not None and caused)

    def _touch(self, number: int) -> None:
        """Push the link that is asked for, and press the head meanwhile: that labels the touch."""
        with suppress(Exception), service_of(self.stand_in, "StandIn") as service:
            self.stand_in.set_fault(f"press:Head/Touch/Middle,seconds={PRESS}")
            link = self.prompts[number]
            service.push({"link": link, "force": [0.0, FORCE, 0.0], "duration": PRESS - 0.2})

    def suffer(self, trouble: Trouble) -> None:
        """Have trouble come, see how the command ends, and that nothing was lost."""
        before = contents(self.folder)
        if trouble.beforehand:
            self.stand_in.set_fault(trouble.beforehand)
        code, lines = self.call(trouble)
        text = "\n".join(lines)
        last = last_words(lines)
        self.ends.append(
            {"trouble": trouble.name, "step": trouble.step, "code": code, "line": last}
        )
        self.expect(code == trouble.code, f"{trouble.name}: exit code {code}, not {trouble.code}")
        self.expect(
            re.search(trouble.words, last) is not None,
            f"{trouble.name}: says not '{trouble.words}': {last}",
        )
        self.expect("Traceback" not in text, f"{trouble.name}: a traceback")
        if code > 0:
            self.expect(
                "the same command goes on" in text, f"{trouble.name}: does not say how to go on"
            )
        if trouble.refused:
            again, more, _ = self._call_once(None)
            refusal = last_words(more)
            self.expect(
                again == 1 and trouble.refused in refusal,
                f"{trouble.name}: not refused: {refusal}",
            )
            self.ends.append(
                {
                    "trouble": f"{trouble.name}, still",
                    "step": trouble.step,
                    "code": again,
                    "line": refusal,
                }
            )
        self.stand_in.clear_faults()
        time.sleep(2.0)
        with service_of(self.stand_in, "ALMotion") as motion:
            motion.wakeUp()
        after = contents(self.folder)
        lost = {name for name, value in before.items() if value not in after.values()}
        lost.discard(STATE)  # which is written again
        self.expect(not lost, f"{trouble.name}: lost {', '.join(sorted(lost))}")

    def refuse(self, plan: Path) -> None:
        """See that the command refuses to go on by another plan, and leaves all as it is."""
        before, given = contents(self.folder), self.arguments
        self.arguments = [*given, "--plan", str(plan)]
        code, lines, _ = self._call_once(None)
        self.arguments = given
        last = last_words(lines)
        self.ends.append({"trouble": "another plan", "step": "", "code": code, "line": last})
        self.expect(code == 2 and "by the plan" in last, f"another plan: not refused: {last}")
        self.expect(contents(self.folder) == before, "another plan: it changed the folder")

    def expect(self, good: bool, problem: str) -> None:
        """Note a problem."""
        if not good:
            self.problems.append(problem)
            print(f"PROBLEM: {problem}", flush=True)


def last_words(lines: Sequence[str]) -> str:
    """Return the line in which the command says why it ended; empty where it was killed."""
    return next((line for line in reversed(lines) if line.startswith("pepper: ")), "")


def contents(folder: Path) -> dict[str, str]:
    """Return the hash of each file of a folder, by name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def page_steps() -> list[str]:
    """Return the steps in the order of the printed page."""
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [name for _, name in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", default="recorded", help="name or file of the simulated robot")
    parser.add_argument("--network", default="wired", choices=("wired", "wifi"))
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--full", action="store_true", help="the shipped plan: an hour and more")
    parser.add_argument("--smooth", action="store_true", help="nothing ends it early")
    parser.add_argument("--weight", action="store_true", help="with a weight in the left hand")
    parser.add_argument("--out", type=Path, help="folder of the hour; by default a temporary one")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    # A shell that starts this in the background has it ignored, and the command would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    console = Console(soft_wrap=True, width=140)
    with TemporaryDirectory() as name:
        temporary = Path(name)
        folder = given.out or temporary / "hour"
        plan = package_file("first_hour.yaml") if given.full else short_plan(temporary)
        prompts = load_touch_prompts(load_robot(), load_first_hour(plan).prompts)
        stand_in = StandIn(
            f"mujoco://?plant={given.plant}&seed={given.seed}", network=given.network, consent=True
        )
        with stand_in:
            with service_of(stand_in, "ALMotion") as motion:
                motion.wakeUp()
            arguments = ["--backend", f"naoqi://127.0.0.1:{stand_in.port}", "--out", str(folder)]
            arguments += ["--label", "head", "--plan", str(plan)]
            if given.weight:
                arguments += ["--weight", "0.5"]
            rehearsal = Rehearsal(
                stand_in=stand_in,
                folder=folder,
                arguments=arguments,
                prompts=[touch.link for touch in prompts.touches],
            )
            began = time.monotonic()
            for trouble in () if given.smooth else TROUBLES:
                console.print(f"-- {trouble.name}, in step {trouble.step}")
                rehearsal.suffer(trouble)
            if not given.smooth:
                rehearsal.refuse(other_plan(plan, temporary))
            console.print("-- to the end")
            code, _ = rehearsal.call(None)
            rehearsal.expect(code == 0, f"the last call ended with {code}")
            minutes = (time.monotonic() - began) / 60.0
        order = [step for step in page_steps() if step != "pack"]
        rehearsal.expect(
            rehearsal.begun == order, f"steps {rehearsal.begun}, and {order} on the page"
        )
        figures: dict[str, Any] = {}
        if code == 0:
            with open_bundle(folder / ARCHIVE) as bundle:
                figures = {
                    step.name: dict(step.figures) for step in load_state(folder / STATE).steps
                }
                rehearsal.expect(
                    bundle.state.next_step is None, "the archive is of an hour that is not done"
                )
                logs = (bundle.rest, bundle.free, bundle.touches)
                texts = [repr((log.metadata, log.events)) for log in map(read_log, logs)]
            with zipfile.ZipFile(folder / ARCHIVE) as archive:
                texts += [archive.read(name).decode("latin-1") for name in archive.namelist()]
            rehearsal.expect("127.0.0.1" not in " ".join(texts), "the archive holds an address")
    table = Table("trouble", "step", "code", "line")
    for end in rehearsal.ends:
        table.add_row(end["trouble"], end["step"], str(end["code"]), end["line"])
    console.print(table)
    for step, found in figures.items():
        console.print(f"{step}: {found}")
    console.print(
        f"{minutes:.1f} min; {len(rehearsal.problems)} problems; {len(rehearsal.other_ends)} calls ended by late "
        "samples or the like"
    )
    for problem in rehearsal.problems:
        console.print(f"problem: {problem}")
    if given.json is not None:
        given.json.write_text(
            json.dumps(
                {
                    "plant": given.plant,
                    "network": given.network,
                    "minutes": minutes,
                    "ends": rehearsal.ends,
                    "problems": rehearsal.problems,
                    "other_ends": rehearsal.other_ends,
                    "figures": figures,
                    "seconds": rehearsal.seconds,
                },
                indent=1,
                default=list,
            )
        )
    raise SystemExit(bool(rehearsal.problems))


if __name__ == "__main__":
    main()
