"""``pepper`` and ``python -m pepper_driver``."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress


def main() -> None:
    """Run the command line and exit with its code, see :func:`pepper_driver.cli.app.run`."""
    signals: AbstractContextManager[object] = nullcontext()
    with _signals_end_at_once():  # importing takes a moment
        from pepper_driver.cli.app import end_by, load_called, run

        if load_called(sys.argv[1:]):
            from pepper_driver.config.signals import raised_signals

            signals = raised_signals()
    try:
        with signals:
            code = run(sys.argv[1:])
    except KeyboardInterrupt as error:
        code = end_by(error)
    except BrokenPipeError:
        code = 1
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # the reader of our output has ended: nothing is left to be flushed
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            code = code or 1
    sys.exit(code)


@contextmanager
def _signals_end_at_once() -> Iterator[None]:
    """Raise nothing in libraries that are being imported: some take it for a defect of their own."""
    words = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}

    def leave(number: int, _: object) -> None:
        with suppress(OSError):
            print(f"pepper: {words[signal.Signals(number).name]}", file=sys.stderr, flush=True)
        os._exit(128 + number)

    changed = {}
    for number in (getattr(signal, name) for name in words if hasattr(signal, name)):
        handler = signal.getsignal(number)
        # And not ignored, as in the background of a shell, or by nohup.
        if handler in (signal.default_int_handler, signal.SIG_DFL):
            changed[number] = handler
            signal.signal(number, leave)
    yield
    for number, handler in changed.items():
        signal.signal(number, handler)


if __name__ == "__main__":
    main()
