"""The commit of a look at the test split, in real repositories."""

from pathlib import Path

import pytest

from pepper_driver.evaluation.touch.commit import CommitError, check_clean, check_resumed
from pepper_driver.evaluation.touch.ledger import look_folder
from support.repositories import commit, git, make_repository


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    return make_repository(tmp_path / "repository")


def allowed(repository: Path, look: int = 1) -> list[Path]:
    path = repository / "docs" / "results" / "ledger.csv"
    return [path, look_folder(path, look)]


def test_a_clean_commit_but_for_the_ledger_and_own_results(repository: Path) -> None:
    head = git(repository, "rev-parse", "HEAD")
    ledger, results = allowed(repository)
    (results / "parts").mkdir(parents=True)
    ledger.write_text("a line\n")
    (results / "parts" / "robot 100.gz").write_text("")
    (repository / "runs").mkdir()
    (repository / "runs" / "ignored").write_text("")
    assert check_clean(repository, allowed(repository)) == head
    assert check_clean(repository / "docs", allowed(repository)) == head
    # Of a look with another number they are not its own, and a name that only begins alike is none of them.
    with pytest.raises(CommitError, match=r"look-1/parts/robot 100.gz; commit them"):
        check_clean(repository, allowed(repository, 2))
    (results.parent / "look-10").mkdir()
    (results.parent / "look-10" / "other").write_text("")
    with pytest.raises(
        CommitError, match=r"these files differ from it: docs/results/look-10/other;"
    ):
        check_clean(repository, allowed(repository))


def test_a_dirty_work_tree_is_named(repository: Path) -> None:
    for name in "abcdefg":
        (repository / f"{name}.py").write_text("new")
    with pytest.raises(CommitError, match=r": a.py, b.py, c.py, d.py, e.py and 2 more; commit"):
        check_clean(repository, allowed(repository))
    git(repository, "clean", "-q", "-f")
    (repository / "code.py").write_text("2\n")
    with pytest.raises(CommitError, match=r": code.py; commit"):
        check_clean(repository, allowed(repository))
    git(repository, "add", "code.py")
    with pytest.raises(CommitError, match=r": code.py; commit"):
        check_clean(repository, allowed(repository))
    git(repository, "reset", "-q", "--hard")
    # Moved into what is allowed: what was moved away is missing all the same.
    allowed(repository)[0].parent.mkdir(parents=True)
    git(repository, "mv", "code.py", "docs/results/ledger.csv")
    with pytest.raises(CommitError, match=r": code.py; commit"):
        check_clean(repository, allowed(repository))


def test_a_look_is_resumed_from_its_own_commit_or_one_after_it(repository: Path) -> None:
    own = git(repository, "rev-parse", "HEAD")
    check_resumed(repository, own)
    commit(repository, "docs/results/ledger.csv", "a line\n")
    check_resumed(repository, own)
    git(repository, "checkout", "-q", "--orphan", "other")
    git(repository, "commit", "-qm", "another root")
    with pytest.raises(
        CommitError, match=rf"from commit {own[:12]}, which HEAD does not come from"
    ):
        check_resumed(repository, own)
    with pytest.raises(CommitError, match="commit 123456789012, which HEAD does not come from"):
        check_resumed(repository, "1234567890123456789012345678901234567890")


def test_without_git_or_a_commit(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(CommitError, match=r"no git repository, .*not a git repository"):
        check_clean(tmp_path, [])
    with pytest.raises(CommitError, match=r"cannot be asked \(there is no such file"):
        check_clean(tmp_path / "nowhere", [])
    empty = tmp_path / "empty"
    empty.mkdir()
    git(empty, "init", "-q")
    with pytest.raises(CommitError, match="has no commit yet"):
        check_clean(empty, [])
    # As in a hook of another repository.
    monkeypatch.setenv("GIT_DIR", str(empty / ".git"))
    assert check_clean(repository, []) != ""
    monkeypatch.setenv("PATH", str(empty))
    with pytest.raises(CommitError, match="needs git"):
        check_clean(repository, [])
