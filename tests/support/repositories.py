"""Repositories of git, for tests of what depends on their commits."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

SETTINGS = ("user.name=someone", "user.email=someone@example.org", "commit.gpgsign=false")


def git(folder: Path, *arguments: str) -> str:
    """Run git in a folder; return what it writes."""
    settings = [part for setting in SETTINGS for part in ("-c", setting)]
    done = subprocess.run(
        ["git", *settings, *arguments], cwd=folder, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def commit(repository: Path, name: str, text: str) -> str:
    """Write a file and commit it with all changes; return the name of the commit."""
    file = repository / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    git(repository, "add", "-A")
    git(repository, "commit", "-q", "-m", name)
    return git(repository, "rev-parse", "HEAD")


def make_repository(folder: Path) -> Path:
    """Make a repository of one file of code in a new folder."""
    if shutil.which("git") is None:
        pytest.skip("no git here")
    folder.mkdir()
    git(folder, "init", "-q")
    commit(folder, ".gitignore", "/runs/\n")
    commit(folder, "code.py", "1\n")
    return folder
