"""``pepper`` and ``python -m pepper_driver``."""

from __future__ import annotations

import sys

from pepper_driver.cli.app import run


def main() -> None:
    """Run the command line and exit with its code: 0 well, 1 a fault of ours, 2 a wrong input, 130 interrupted."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
