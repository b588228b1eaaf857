"""``pepper examples``: the example programs, experiments and plug-ins, listed or copied."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path
from shutil import copyfile
from typing import Annotated

import typer

from pepper_driver.cli.console import make_console
from pepper_driver.config.errors import reason
from pepper_driver.config.files import OutputError, make_folder
from pepper_driver.config.loading import read_yaml

SUFFIXES = (".py", ".yaml", ".md", ".toml", ".json", ".xml", ".ipynb")

PACKAGE = Path(__file__).parents[1]


def examples_command(
    out: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="Folder to copy them to; else list them.")
    ] = None,
) -> None:
    """Copy the examples into a folder, or list them. Nothing that is there is replaced."""
    console, folder = make_console(), examples_folder()
    if out is not None:
        count = copy_examples(folder, out)
        console.print(f"{count} files in {out}; {out / 'README.md'} says what they show")
        return
    listed = list(summaries(folder))
    width = max(len(name) for name, _ in listed)
    for name, summary in listed:
        console.print(f"{name:{width}s}  {summary}")
    console.print("pepper examples DIR copies them into a folder.")


def examples_folder() -> Path:
    """Return the folder of the examples: inside an installed package, next to it in a checkout."""
    inside, sibling = PACKAGE / "examples", PACKAGE.parent / "examples"
    return inside if inside.is_dir() else sibling


def copy_examples(folder: Path, out: Path) -> int:
    """Copy all files of the examples into a folder, which is made; return their number.

    Raises:
        OutputError: One of the files is there already, or cannot be written; in the first case nothing is copied.
    """
    names = sorted(
        path.relative_to(folder) for path in folder.rglob("*") if path.suffix in SUFFIXES
    )
    for name in names:
        if (out / name).exists():
            raise OutputError(f"{out / name}: is there already; choose another folder")
    for name in names:
        make_folder((out / name).parent)
        try:
            copyfile(folder / name, out / name)
        except OSError as error:
            raise OutputError(f"{out / name}: cannot be written ({reason(error)})") from error
    return len(names)


def summaries(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield name and summary of each program, experiment, notebook and plug-in."""
    for path in sorted(folder.glob("*.py")):
        yield path.name, _summary(path)
    for path in sorted(folder.glob("experiments/*.yaml")):
        yield f"experiments/{path.name}", str(read_yaml(path).get("description", ""))
    for path in sorted(folder.glob("notebooks/*.ipynb")):
        title = json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"][0]
        yield f"notebooks/{path.name}", title.strip("# \n")
    for path in sorted(folder.glob("plugins/*/*.py")):
        if not path.name.startswith("test_"):
            yield f"plugins/{path.parent.name}", _summary(path)


def _summary(program: Path) -> str:
    """Return the first line of a program's docstring, without how to run it."""
    docstring = ast.get_docstring(ast.parse(program.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0].partition(" Run: ")[0]
