"""Processes of the stand-in: started, and told over a line of their own that whoever started them is gone."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.messages import make_pair, receive, send

START_TIME = 30.0
"""[s] for a process to start; it takes about one."""


def spawn(
    module: str,
    arguments: Mapping[str, Any],
    descriptors: Mapping[str, int],
    first: Mapping[str, Any] | None = None,
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """A process of this package, and the line on which it says it is ready and hears that we are gone.

    Args:
        module: Its name in this package.
        arguments: For its command line, which everybody on this machine can read.
        descriptors: Of open files, which are arguments too.
        first: A message that it finds on its line.
    """
    mine, its = make_pair()
    if first is not None:
        send(mine, dict(first))
    descriptors = {**descriptors, "owner": its.fileno()}
    words = [f"--{name}={value}" for name, value in {**arguments, **descriptors}.items()]
    with its:
        # A process group of its own: Ctrl-C is for us alone.
        process = subprocess.Popen(
            [sys.executable, "-m", f"pepper_driver.backends.naoqi_server.{module}", *words],
            pass_fds=tuple(descriptors.values()),
            stdin=subprocess.DEVNULL,
            process_group=0,
        )
    return process, mine


def wait_until_ready(process: subprocess.Popen[bytes], line: socket.socket) -> dict[str, Any]:
    """What a process says when it is ready.

    Raises:
        BackendError: It refuses, for the reason given, or ended.
    """
    line.settimeout(START_TIME)
    try:
        answer = receive(line)
    except TimeoutError:
        answer = {"error": f"a process did not start within {START_TIME:.0f} s"}
    if answer is None or "error" in answer:
        process.kill()
        process.wait()
        line.close()
        reason = "a process ended while it started" if answer is None else answer["error"]
        raise BackendError(f"stand-in: {reason}")
    return dict(answer["ready"])
