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
) -> tuple[subprocess.Popen[bytes], socket.socket, dict[str, Any]]:
    """A process of this package, the line on which it hears that we are gone, and what it says when it is ready.

    Args:
        module: Its name in this package.
        arguments: For its command line, which everybody on this machine can read.
        descriptors: Of open files, which are arguments too.
        first: A message that it finds on its line.

    Raises:
        BackendError: It refuses, for the reason given, or ended.
    """
    mine, its = make_pair()
    if first is not None:
        send(mine, dict(first))
    descriptors = {**descriptors, "owner": its.fileno()}
    words = [f"--{name}={value}" for name, value in {**arguments, **descriptors}.items()]
    with its:
        # A process group of its own: Ctrl-C is for us, and what is stopped when we die is continued and ends.
        process = subprocess.Popen(
            [sys.executable, "-m", f"pepper_driver.backends.naoqi_server.{module}", *words],
            pass_fds=tuple(descriptors.values()),
            stdin=subprocess.DEVNULL,
            process_group=0,
        )
    mine.settimeout(START_TIME)
    try:
        answer = receive(mine)
    except TimeoutError:
        answer = {"error": f"did not start within {START_TIME:.0f} s"}
    if answer is None or "error" in answer:
        process.kill()
        process.wait()
        mine.close()
        reason = "ended while it started" if answer is None else answer["error"]
        raise BackendError(f"stand-in: {reason}")
    return process, mine, dict(answer["ready"])
