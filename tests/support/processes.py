"""Processes that tests stop."""

import os
import signal


def suspend(pid: int) -> None:
    """Stop a child process as SIGSTOP does, and wait until all of its threads stand.

    The signal alone only begins this: a thread on another processor may still answer a call.
    """
    os.kill(pid, signal.SIGSTOP)
    os.waitid(os.P_PID, pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
