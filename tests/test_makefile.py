"""The Makefile's targets, as its first lines list them."""

import re
import subprocess
from pathlib import Path

import pytest

from support import ROOT

TEXT = (ROOT / "Makefile").read_text()
TARGETS = re.findall(r"make ([a-z-]+):", TEXT[: TEXT.index("PYTHON ?=")])
EXTRAS = {"demo": "plot", "naoqi": "naoqi", "test": "dev", "bench-controller": "peers"}


def commands(target: str, tmp_path: Path) -> str:
    """Commands that ``make`` would run for a target in a new checkout."""
    command = ["make", "--dry-run", f"VENV={tmp_path / 'venv'}", target]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def test_the_first_lines_list_every_target() -> None:
    (phony,) = re.findall(r"^\.PHONY: (.*)", TEXT, re.MULTILINE)
    assert sorted(TARGETS) == sorted(phony.split())


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_can_be_made(target: str, tmp_path: Path) -> None:
    assert commands(target, tmp_path)


@pytest.mark.parametrize(("target", "extra"), EXTRAS.items())
def test_a_target_installs_its_extra_once(target: str, extra: str, tmp_path: Path) -> None:
    assert re.findall(r'-e "\.\[(.*)\]"', commands(target, tmp_path)) == [extra]
