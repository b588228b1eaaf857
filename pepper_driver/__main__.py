"""``pepper`` and ``python -m pepper_driver``."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def main() -> None:
    """Run the command line and exit with its code: 0 well, 1 a fault of ours, 2 a wrong input, 130 interrupted."""
    try:
        with _ctrl_c_ends_at_once():
            from pepper_driver.cli.app import run  # takes a moment, in which somebody may press it

        code = run(sys.argv[1:])
        sys.stdout.flush()
    except KeyboardInterrupt:
        _say_interrupted()
        code = 130
    except BrokenPipeError:  # whoever read our output has gone; nothing is left to be flushed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code)


@contextmanager
def _ctrl_c_ends_at_once() -> Iterator[None]:
    """Raise nothing in libraries that are being imported: some take it for a defect of their own."""

    def leave(*_: object) -> None:
        _say_interrupted()
        os._exit(130)

    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # and not ignored, as in the background of a shell
        signal.signal(signal.SIGINT, leave)
    yield
    signal.signal(signal.SIGINT, before)


def _say_interrupted() -> None:
    print("pepper: interrupted", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
