"""Code lines of files, without blank lines, comments and docstrings.

A bare string is a docstring wherever it stands. With --facade: of the modules between a user and the layers below, then
and now.

Run: python benchmarks/code_lines.py --facade
     python benchmarks/code_lines.py --commit HEAD~5 pepper_driver/loop.py
"""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
import tokenize
from io import BytesIO
from pathlib import Path
from typing import NoReturn

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]

# The modules that `Pepper`, its loop and its callbacks consisted of before the loop had a thread of its own.
BASELINE_COMMIT, BASELINE_TOTAL = "8e67b0d", 1835
BASELINE = (
    "pepper_driver/robot.py",
    "pepper_driver/listening.py",
    "pepper_driver/session.py",
    "pepper_driver/loop.py",
    "pepper_driver/runner.py",
    "pepper_driver/waiting.py",
    "pepper_driver/pacing.py",
    "pepper_driver/realtime.py",
    "pepper_driver/timing.py",
    "pepper_driver/callbacks.py",
    "pepper_driver/callback_thread.py",
    "pepper_driver/queue_thread.py",
    "pepper_driver/filters.py",
    "pepper_driver/contact_stream.py",
    "pepper_driver/events.py",
    "pepper_driver/sensor_edges.py",
    "pepper_driver/services.py",
    "pepper_driver/reflexes/control.py",
    "pepper_driver/reflexes/arbiter.py",
)
# The modules that do the same, and more, today: follow them here when they move.
FACADE = (
    "pepper_driver/robot.py",
    "pepper_driver/session.py",
    "pepper_driver/loop.py",
    "pepper_driver/realtime.py",
    "pepper_driver/callbacks/callback_registry.py",
    "pepper_driver/callbacks/dispatcher.py",
    "pepper_driver/callbacks/events.py",
    "pepper_driver/callbacks/filters.py",
    "pepper_driver/callbacks/waiting.py",
    "pepper_driver/services.py",
    "pepper_driver/reflexes/arbiter.py",
    "pepper_driver/reflexes/requests.py",
    "controller/changes.py",
)

NO_CODE = (
    tokenize.ENCODING,
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)


class SourceError(Exception):
    """A file that cannot be counted."""


def source(name: str | Path, commit: str | None) -> bytes:
    """Read a file of the work tree, or of this repository as of a commit."""
    if commit is None:
        try:
            return Path(name).read_bytes()
        except OSError as error:
            raise SourceError(f"cannot read '{name}': {error.strerror}") from error
    path = Path(name).resolve()
    if not path.is_relative_to(ROOT):
        raise SourceError(f"'{name}' is not in the repository {ROOT}")
    blob = f"{commit}:{path.relative_to(ROOT).as_posix()}"
    try:
        shown = subprocess.run(
            ["git", "-C", str(ROOT), "cat-file", "blob", blob], capture_output=True, check=True
        )
    except FileNotFoundError as error:
        raise SourceError("--commit needs git, which is not installed") from error
    except subprocess.CalledProcessError as error:
        reason = error.stderr.decode(errors="replace").strip().partition("\n")[0]
        raise SourceError(f"no file '{name}' as of commit '{commit}': {reason}") from error
    return shown.stdout


def code_lines(name: str | Path, commit: str | None = None) -> int:
    """Count the lines of a file that hold code."""
    text = source(name, commit)
    try:
        docstrings = {
            (node.lineno, node.col_offset)
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        }
        lines: set[int] = set()
        for token in tokenize.tokenize(BytesIO(text).readline):
            if token.type not in NO_CODE and token.start not in docstrings:
                lines.update(range(token.start[0], token.end[0] + 1))
    except (SyntaxError, ValueError, tokenize.TokenError) as error:
        raise SourceError(f"'{name}' is not Python: {error}".partition("\n")[0]) from error
    return len(lines)


class Parser(argparse.ArgumentParser):
    """Parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"code_lines.py: {message}", file=sys.stderr)
        sys.exit(2)


def main() -> int:
    """Command line: 0 well, 2 a wrong input."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", metavar="FILE")
    parser.add_argument("--commit", metavar="REV", help="count the files as of this commit")
    parser.add_argument(
        "--facade",
        action="store_true",
        help="count facade and loop, compared with what they once were",
    )
    given = parser.parse_args()
    if given.facade == bool(given.files):
        parser.error("give either files or --facade")
    files = [str(ROOT / name) for name in FACADE] if given.facade else given.files
    try:
        counts = [code_lines(name, given.commit) for name in files]
    except SourceError as error:
        parser.error(str(error))
    table = Table("file", "code lines")
    for name, count in zip(FACADE if given.facade else files, counts, strict=True):
        table.add_row(name, str(count))
    table.add_section()
    table.add_row("total", str(sum(counts)))
    if given.facade:
        table.add_row(f"at {BASELINE_COMMIT}", str(BASELINE_TOTAL))
        table.add_row("now / then", f"{sum(counts) / BASELINE_TOTAL:.3f}")
    Console(soft_wrap=True, highlight=False, markup=False).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
