"""The commit that is judged: its work tree is clean, and a look is resumed from its own commit or one after it."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from pepper_driver.config import PepperError
from pepper_driver.config.errors import reason

MAX_NAMED_FILES = 5
"""Files that a message names."""


class CommitError(PepperError, RuntimeError):
    """The commit is not one from which a look may be taken."""


def check_clean(root: Path, allowed: Sequence[Path]) -> str:
    """Return the commit of a work tree, which must be clean.

    Args:
        root: A folder of the work tree.
        allowed: Files and folders that may differ: the ledger, and results of the look.

    Raises:
        CommitError: There is no git, no repository or no commit here; or a file differs from the commit or is new.
    """
    top = work_tree(root)
    entries = iter(git(top, "status", "--porcelain=v1", "-z", "--untracked-files=all").split("\0"))
    names = []
    for entry in filter(None, entries):
        names.append(entry[3:])
        if "R" in entry[:2] or "C" in entry[:2]:
            names.append(next(entries))  # the name before
    if others := _others(top, names, allowed):
        raise CommitError(
            f"the test split is looked at only from a clean commit, and these files differ from it: {_named(others)}; "
            "commit them, or undo the changes"
        )
    return _head(top)


def check_resumed(root: Path, commit: str) -> None:
    """Refuse to resume a look of a commit that HEAD does not come from.

    :func:`begin_look` has compared code, constants and suites; other files, such as pages and documentation, may have
    changed since.

    Args:
        root: A folder of the work tree.
        commit: Of the look.

    Raises:
        CommitError: The commit is not known here, or is no ancestor of HEAD.
    """
    top = work_tree(root)
    try:
        git(top, "merge-base", "--is-ancestor", commit, "HEAD")
    except CommitError as error:
        raise CommitError(
            f"the unfinished look was begun from commit {commit[:12]}, which HEAD does not come from; 'git checkout' a "
            "branch that does"
        ) from error


def versions_of(root: Path, name: str) -> dict[str, str]:
    """Return a file as HEAD and the branches have it, by their names; those without it are left out.

    Args:
        root: A folder of the work tree.
        name: File, relative to the top of the work tree.

    Raises:
        CommitError: There is no repository.
    """
    top = work_tree(root)
    branches = git(top, "for-each-ref", "--format=%(refname:short)", "refs/heads").split()
    found = {}
    for reference in ("HEAD", *branches):
        try:
            found[reference] = git(top, "show", f"{reference}:{name}")
        except CommitError:
            continue
    return found


def _others(top: Path, names: Iterable[str], allowed: Sequence[Path]) -> list[str]:
    """Return the names, relative to ``top``, that lie in nothing that is allowed."""
    free = [path.resolve() for path in allowed]
    return [
        name
        for name in names
        if not any((place := top / name) == one or one in place.parents for one in free)
    ]


def _named(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMED_FILES
    return ", ".join(names[:MAX_NAMED_FILES]) + (f" and {more} more" if more > 0 else "")


def work_tree(root: Path) -> Path:
    """Return the top folder of the work tree that a folder is in.

    Raises:
        CommitError: There is no git, or no repository here.
    """
    if shutil.which("git") is None:
        raise CommitError("the test split needs git, to know the commit that is judged: install it")
    try:
        return Path(git(root, "rev-parse", "--show-toplevel").removesuffix("\n")).resolve()
    except CommitError as error:
        raise CommitError(
            f"{root}: no git repository, and the test split is looked at only from a commit of one ({error})"
        ) from error


def _head(top: Path) -> str:
    try:
        return git(top, "rev-parse", "--verify", "HEAD^{commit}").strip()
    except CommitError as error:
        raise CommitError(f"{top}: the repository has no commit yet") from error


_OF_HOOKS = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_OBJECT_DIRECTORY", "GIT_PREFIX")
"""Variables that git sets for its hooks, and that would name another repository."""


def git(folder: Path, *arguments: str) -> str:
    """Return the output of git in a folder."""
    environment = {key: value for key, value in os.environ.items() if key not in _OF_HOOKS}
    try:
        done = subprocess.run(
            ["git", *arguments],
            cwd=folder,
            env={**environment, "LC_ALL": "C", "GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="surrogateescape",
            check=False,
        )
    except OSError as error:
        raise CommitError(f"{folder}: git cannot be asked ({reason(error)})") from error
    if done.returncode:
        said = next(iter(done.stderr.strip().splitlines()), f"error {done.returncode}")
        raise CommitError(f"git: {said.removeprefix('fatal: ')}")
    return done.stdout
