"""What README and examples promise, run as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PROGRAMS = ("robot", "callbacks", "controller", "reflexes", "realtime")
"""Pages whose blocks of code, one after the other, are a program."""


def python_blocks(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


def test_the_code_in_readme_feels_a_push(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = python_blocks(ROOT / "README.md")
    exec(compile(block, "README.md", "exec"), {})
    line = r"LBicep: LShoulderRoll pushed \+1, [2-4]\.\d deg\n"
    assert re.fullmatch(line, capsys.readouterr().out)


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_code_in_the_documentation_runs(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.py"
    file.write_text("\n".join(python_blocks(ROOT / "docs" / f"{name}.md")))
    done = subprocess.run(
        [sys.executable, str(file)], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_examples_run(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip()
    assert not done.stderr


def test_links_in_the_documentation_lead_somewhere() -> None:
    for page in [
        ROOT / "README.md",
        ROOT / "examples" / "README.md",
        *(ROOT / "docs").glob("*.md"),
    ]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name} links to {target}"
