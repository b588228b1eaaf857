"""Promises of README and examples, run as they stand there."""

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from shutil import copy
from typing import Any

import pytest
import typer
from typer.core import TyperGroup

from pepper_driver import Pepper
from pepper_driver.backends import Measurement
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.cli.app import load_command
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.log import Label, read_log
from pepper_driver.log.export import export_log
from pepper_driver.log.topics import LabelPhase
from support import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PAGES = [
    ROOT / "README.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
PROGRAMS = [
    page.stem
    for page in PAGES
    if page.parent.name == "docs"
    and "```python" in page.read_text()
    and "stand_in" not in page.stem
]
"""Pages whose blocks of code, one after the other, are a program."""


def python_blocks(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


def test_the_code_in_readme_detects_a_push(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = python_blocks(ROOT / "README.md")
    exec(compile(block, "README.md", "exec"), {})
    line = r"LBicep: LShoulderRoll pushed \+1, \d+ N \(\d+ to \d+, scale unknown\)\n"
    assert re.fullmatch(line, capsys.readouterr().out)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that pages speak of."""
    desk = tmp_path_factory.mktemp("desk")
    with Pepper("mujoco") as pepper:
        log = pepper.start_log(desk / "run.mcap", _touched())
        pepper.run(0.6)
    assert log.path.is_file()
    export_log(read_log(desk / "run.mcap"), desk / "run.parquet", "parquet")
    (desk / "runs" / "demo").mkdir(parents=True)
    for name in ("touches.mcap", "runs/demo/demo.mcap"):
        copy(desk / "run.mcap", desk / name)
    copy(ROOT / "observer" / "models" / "nominal-fusion.json", desk / "my_models.json")
    (desk / "examples").symlink_to(ROOT / "examples")
    return desk


def _touched() -> Callable[[Measurement], Sequence[Label]]:
    """A labeller: a person touches the left hand for 0.2 s."""
    ticks = count()

    def label(measurement: Measurement) -> Sequence[Label]:
        phases: dict[int, LabelPhase] = {10: "onset", 26: "release"}
        if (tick := next(ticks)) not in phases:
            return ()
        at: dict[str, Any] = {"time": measurement.time, "link": "l_wrist", "joint": "LWristYaw"}
        return [Label(phase=phases[tick], source="key", **at)]

    return label


@pytest.mark.whole
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_code_in_the_documentation_runs(name: str, desk: Path) -> None:
    """All blocks of a page, one after the other."""
    _run("\n".join(python_blocks(ROOT / "docs" / f"{name}.md")), desk)


@pytest.mark.whole
def test_the_code_for_the_stand_in_runs(desk: Path) -> None:
    with StandIn("mujoco") as stand_in:
        for name in ("stand_in", "stand_in_services"):
            code = "\n".join(python_blocks(ROOT / "docs" / f"{name}.md"))
            _run(code.replace("9559", str(stand_in.port)), desk)


def _run(code: str, folder: Path) -> None:
    file = folder / "program.py"
    file.write_text(code)
    done = subprocess.run(
        [sys.executable, str(file)], capture_output=True, text=True, cwd=folder, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.realtime
@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")), ids=lambda path: path.name
)
def test_the_cells_of_a_notebook_run(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One after the other; the page is served, and the pull and the push are detected."""
    pytest.importorskip("viser")
    names: dict[str, Any] = {}
    try:
        for cell in json.loads(path.read_text())["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), path.name, "exec"), names)
    finally:
        names["pepper"].show().close()
        names["pepper"].stop()
    assert "contact on left_arm" in capsys.readouterr().out
    assert names["detected"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_commands_in_the_documentation_are_ours(page: Path) -> None:
    """Sub-command, arguments and options of each; nothing is run."""
    for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL):
        for line in map(str.strip, block.splitlines()):
            if line.startswith("pepper "):
                words = shlex.split(line, comments=True)[1:]
                command: Any = load_command(words.pop(0))
                while isinstance(command, TyperGroup):
                    name = words.pop(0)
                    command = command.get_command(typer.Context(command), name)
                    assert command is not None, f"{page.name}: {line}"
                command.make_context(line, words)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_experiments_in_the_documentation_load(page: Path, tmp_path: Path) -> None:
    for number, block in enumerate(re.findall(r"```yaml\n(.*?)```", page.read_text(), re.DOTALL)):
        if block.startswith("schema:"):
            file = tmp_path / f"{number}.yaml"
            file.write_text(block)
            load_experiment(file, load_robot())


def test_the_suite_that_the_documentation_shows_is_one(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "plugins.md").read_text()
    (block,) = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    (tmp_path / "test_mine.py").write_text(block.replace("myrobot://", "mock://"))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "opened"]
    done = subprocess.run(
        [*command, str(tmp_path)], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert done.returncode == 0, done.stdout
    assert re.search(r"[2-9] passed", done.stdout)


@pytest.mark.whole
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_examples_run(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        timeout=120,
    )
    assert done.stdout.strip()
    assert not done.stderr
