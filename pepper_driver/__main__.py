"""``pepper`` and ``python -m pepper_driver``."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line and exit with its code: 0 well, 1 a fault of ours, 2 a wrong input, 130 interrupted."""
    try:
        from pepper_driver.cli.app import run  # takes a moment, in which somebody may press Ctrl-C

        code = run(sys.argv[1:])
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("pepper: interrupted", file=sys.stderr)
        code = 130
    except BrokenPipeError:  # whoever read our output has gone; nothing is left to be flushed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code)


if __name__ == "__main__":
    main()
