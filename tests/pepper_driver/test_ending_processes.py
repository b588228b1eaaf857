"""Real signals to real programs: exit code, what is said, the log, and that no process of theirs is left.

Bounds of time are for busy machines; docs/results/realtime.md has what was measured.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from pepper_driver.log import read_log
from support.experiments import STAND, write
from support.waiting import PATIENCE, wait_until

END_TIME = 10.0
"""[s] for a program to end."""


def children(pid: int) -> list[int]:
    """Its children, and theirs."""
    text = "".join(path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children"))
    direct = [int(child) for child in text.split()]
    return direct + [further for child in direct for further in children(child)]


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"  # the process that should reap it is not ours


@contextmanager
def program(*command: str, until: str, group: bool = False) -> Iterator[subprocess.Popen[str]]:
    """A Python program that has printed a line with ``until``."""
    process = subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=group,
    )
    assert process.stdout is not None
    try:
        assert any(until in line for line in process.stdout), process.communicate()[1]
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process: subprocess.Popen[str], number: int) -> str:
    """Send a signal; returns what it says then."""
    begin = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - begin < END_TIME
    return "\n".join(line for line in errors.splitlines() if "missed so far" not in line)


# -- scripts --------------------------------------------------------------------------------------------------------

SCRIPT = """
import sys, time
from pepper_driver import Pepper
where, log = sys.argv[1:]
pepper = Pepper("mujoco", observer=None, real_time=True, log=log)
if where == "notebook":
    pepper.start()
    print("ready", flush=True)
    time.sleep(60.0)
with pepper:
    print("ready", flush=True)
    if where == "sleep":
        time.sleep(60.0)
    elif where == "input":
        input()
    elif where == "run":
        pepper.run(60.0)
    while True:
        pass
"""


@pytest.mark.parametrize(
    ("where", "number", "code", "said"),
    [
        ("input", signal.SIGHUP, 129, "hung up; log: {log}"),
        ("run", signal.SIGTERM, 143, "terminated; log: {log}"),
        ("compute", signal.SIGINT, -signal.SIGINT, "KeyboardInterrupt\nlog: {log}"),
        ("notebook", signal.SIGTERM, 143, ""),
    ],
)
def test_a_script_ends_in_order_wherever_it_is(
    where: str, number: int, code: int, said: str, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    with program("-c", SCRIPT, where, str(log), until="ready") as process:
        errors = end(process, number)
    assert process.returncode == code
    expected = said.format(log=log)
    assert errors.endswith(expected) if number == signal.SIGINT else errors == expected, errors
    assert read_log(log).complete


def test_two_signals_at_once_end_it_once(tmp_path: Path) -> None:
    """As of systemd, and of a terminal that closes."""
    log = tmp_path / "run.mcap"
    with program("-c", SCRIPT, "sleep", str(log), until="ready") as process:
        process.send_signal(signal.SIGHUP)
        process.send_signal(signal.SIGHUP)
        errors = end(process, signal.SIGTERM)
    assert process.returncode in (129, 143), "whichever is first"
    assert errors in (f"hung up; log: {log}", f"terminated; log: {log}")
    assert read_log(log).complete


def test_nohup_keeps_it_running(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    script = f"import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n{SCRIPT}"
    with program("-c", script, "sleep", str(log), until="ready") as process:
        process.send_signal(signal.SIGHUP)
        time.sleep(0.3)
        assert process.poll() is None
        assert end(process, signal.SIGTERM) == f"terminated; log: {log}"
    assert process.returncode == 143


# -- commands -------------------------------------------------------------------------------------------------------

IN_TERMINAL = """
import fcntl, runpy, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
sys.argv[0] = "pepper"
runpy.run_module("pepper_driver", run_name="__main__")
"""


def test_a_terminal_that_is_closed_ends_the_command(tmp_path: Path) -> None:
    """By SIGHUP; and whatever is printed from then on fails."""
    log = tmp_path / "run.mcap"
    path = write(tmp_path, STAND, {"name": "wait", "hold": 600.0}, observer=None)
    command = ["run", str(path), "--log", str(log), "--real-time"]
    far, near = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL, *command],
        stdin=near,
        stdout=near,
        stderr=near,
        start_new_session=True,
    )
    os.close(near)
    try:
        shown = b""
        while b"step wait" not in shown:
            shown += os.read(far, 4096)
        os.close(far)
        assert process.wait(PATIENCE) == 129
    finally:
        process.kill()
        process.wait()
    assert read_log(log).complete


# -- worker processes -----------------------------------------------------------------------------------------------

JOBS = """
import time
from functools import partial
from pepper_driver.config.signals import raised_signals
from pepper_driver.config.workers import run_jobs
with raised_signals():
    jobs = [partial(time.sleep, seconds) for seconds in (0.1, 60, 60, 60)]
    for _ in run_jobs(jobs, workers=2, ordered=False):
        print("working", flush=True)
"""


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGTERM, 143), (signal.SIGINT, -signal.SIGINT), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_workers_end_with_the_process_that_started_them(number: int, code: int) -> None:
    with program("-c", JOBS, until="working") as process:
        workers = children(process.pid)
        assert len(workers) >= 2
        process.send_signal(number)
        assert process.wait(END_TIME) == code
        ended = wait_until(lambda: not any(map(alive, workers)), END_TIME)
        for pid in filter(alive, workers):
            os.kill(pid, signal.SIGKILL)
        assert ended
        _, errors = process.communicate()
    if number == signal.SIGTERM:
        assert not errors


LEAK = """
from time import sleep
from functools import partial
from joblib.externals.loky.backend import resource_tracker
from pepper_driver.config.workers import run_jobs
list(run_jobs([partial(sleep, 0.0)] * 2, workers=2))
resource_tracker.register("/loky-ended", "semlock")  # as by a thread that ends between unlinking and saying so
print("leaked", flush=True)
"""


def test_what_was_left_to_the_tracker_of_joblib_is_no_news() -> None:
    with program("-c", LEAK, until="leaked") as process:
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert not errors


def test_ctrl_c_in_a_terminal_is_for_the_first_process_alone() -> None:
    """It comes to all of them; the workers say nothing, not even those that have not begun."""
    with program("-c", JOBS, until="working", group=True) as process:
        workers = children(process.pid)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
        assert wait_until(lambda: not any(map(alive, workers)), END_TIME)
    assert errors.count("Traceback") == 1, errors


GROUP_JOBS = """
import os, signal, sys, threading, time
from functools import partial
from joblib.parallel import LokyBackend
from pepper_driver.config.signals import raised_signals
from pepper_driver.config.workers import run_jobs

number, where = int(sys.argv[1]), sys.argv[2]
threading.Thread(target=threading.Event().wait, daemon=True).start()  # gets signals too, as that of a progress bar
arrived, writer = os.pipe()
os.set_blocking(writer, False)
signal.set_wakeup_fd(writer)

def signal_itself():
    os.kill(os.getpid(), number)

def work():
    with raised_signals():  # as a run does
        time.sleep(600.0)

def jobs():
    yield from (signal_itself, work)
    if where == "starting":  # the workers have these two, and import
        os.killpg(0, number)
        os.read(arrived, 1)
        print("starting", flush=True)
    yield from (work, work)
    yield from (work, work)

def submit(self, *arguments):  # the first job is done: another thread hands in the next one
    if where == "submitting" and threading.current_thread() is not threading.main_thread():
        print("submitting", flush=True)
        os.killpg(0, number)
        time.sleep(0.5)  # the main thread begins to end it all
    return joblib_submit(self, *arguments)

joblib_submit, LokyBackend.submit = LokyBackend.submit, submit

with raised_signals():
    for _ in run_jobs(map(partial, jobs()), workers=2, ordered=False):
        if where == "working":
            print("working", flush=True)
            os.killpg(0, number)
        time.sleep(600.0)
"""


@pytest.mark.parametrize(
    ("where", "number", "code"),
    [
        ("starting", signal.SIGTERM, 143),
        ("starting", signal.SIGHUP, 129),
        ("starting", signal.SIGINT, -signal.SIGINT),
        ("working", signal.SIGTERM, 143),
        ("submitting", signal.SIGTERM, 143),
    ],
)
def test_a_signal_to_the_whole_group_ends_it_without_pgrep(
    where: str, number: int, code: int
) -> None:
    """As of ``timeout`` and a terminal, on a machine that lacks the program by which joblib can end workers."""
    process = subprocess.Popen(
        [sys.executable, "-c", GROUP_JOBS, str(number), where],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PATH": ""},
    )
    try:
        shown, errors = process.communicate(timeout=PATIENCE)  # which waits for the workers too
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == code, errors
    assert shown == f"{where}\n"
    assert errors.count("Traceback") == (number == signal.SIGINT), errors
    assert number == signal.SIGINT or not errors
