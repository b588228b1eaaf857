"""Mutation testing: whether tests notice small errors in the code that keeps people safe.

Each mutant is one change of the source: another comparison, a number one larger, a statement left out. The subject's
tests run against it, and at least one of them must fail. Results are kept, mutant by mutant: an interrupted run
continues where it was. Where a file changes its mutants are judged again; where tests change those that survived are.
Run: python benchmarks/mutation.py, with the extra 'mutation'
"""

from __future__ import annotations

import argparse
import ast
import compileall
import difflib
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from py_compile import PycInvalidationMode

import parso
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

from pepper_driver.config.files import write_text

ROOT = Path(__file__).resolve().parents[1]
SAFETY = "tests/pepper_driver/safety/"


@dataclass(frozen=True)
class Subject:
    """Code that must not fail, and the tests that watch over it.

    Attributes:
        name: Of both.
        code: File, then the classes and functions in it that count; all if there are none.
        tests: Arguments of pytest, the fastest first.
    """

    name: str
    code: tuple[tuple[str, tuple[str, ...]], ...]
    tests: tuple[str, ...]


SUBJECTS = (
    Subject(
        "safety gate",
        (
            ("pepper_driver/safety/gate.py", ()),
            ("pepper_driver/safety/limits.py", ()),
            ("pepper_driver/safety/monitor.py", ()),
            ("pepper_driver/safety/states.py", ()),
        ),
        tuple(
            SAFETY + name
            for name in (
                "test_gate.py",
                "test_limits.py",
                "test_states.py",
                "test_monitor.py",
                "test_safety_faults.py",
            )
        ),
    ),
    Subject(
        "plug-ins",
        (("pepper_driver/safety/plugins.py", ()),),
        (f"{SAFETY}test_plugins.py",),
    ),
    Subject(
        "arbiter",
        (("pepper_driver/reflexes/arbiter.py", ()),),
        tuple(
            f"tests/pepper_driver/reflexes/{name}.py"
            for name in (
                "test_arbiter",
                "test_holding",
                "test_hold",
                "test_returning",
                "test_reflexes",
            )
        ),
    ),
    Subject(
        "watchdogs",
        (
            ("backends/naoqi/dcm_channel.py", ("sample_age", "Orders")),
            ("backends/naoqi/dcm_io.py", ("Writer",)),
        ),
        (
            "tests/backends/naoqi/test_naoqi_orders.py",
            "tests/backends/naoqi/test_naoqi_watchdog.py",
            "tests/backends/naoqi/test_naoqi_link.py",
            "tests/backends/naoqi/test_naoqi_backend.py",
        ),
    ),
    Subject(
        "dead-man",
        (
            ("backends/mock.py", ("MockBackend.read", "MockBackend.write")),
            ("backends/mujoco_/backend.py", ("MujocoBackend.read", "MujocoBackend.write")),
        ),
        (
            "tests/backends/test_mock.py",
            "tests/backends/mujoco_/test_mujoco_backend.py",
            "tests/pepper_driver/test_conformance.py::TestMock",
            "tests/pepper_driver/test_conformance.py::TestMujoco",
        ),
    ),
    Subject(
        "contact events",
        (("observer/detection/excursions.py", ()),),
        (
            "tests/observer/detection/test_excursions.py",
            "tests/observer/test_contact_observer.py",
        ),
    ),
    Subject(
        "threshold",
        (("observer/detection/threshold.py", ()),),
        (
            "tests/observer/detection/test_threshold.py",
            "tests/observer/residuals/test_fusion_learning.py",
            "tests/observer/residuals/test_hand_loads.py",
        ),
    ),
    Subject(
        "doubt",
        (("observer/residuals/doubt.py", ()),),
        ("tests/observer/residuals/test_doubt.py",),
    ),
    Subject(
        "channels",
        (("observer/residuals/channels.py", ()),),
        (
            "tests/observer/residuals/test_channels.py",
            "tests/observer/residuals/test_fusion_learning.py",
            "tests/observer/residuals/test_fusion_faults.py",
            "tests/observer/residuals/test_fusion.py",
        ),
    ),
    Subject(
        "board law",
        (("observer/residuals/board_law.py", ()),),
        ("tests/observer/residuals/test_board_law.py",),
    ),
    Subject(
        "confirmation",
        (("observer/detection/confirmation.py", ()),),
        ("tests/observer/detection/test_confirmation.py",),
    ),
    Subject(
        "body isolation",
        (("observer/detection/body_isolation.py", ()),),
        ("tests/observer/detection/test_body_isolation.py",),
    ),
    Subject(
        "plug-ins",
        (("pepper_driver/safety/plugins.py", ()),),
        (SAFETY + "test_plugin_check.py",),
    ),
)


class RemoveStatement(Operator):
    """Replaces a call or an assignment by ``pass``."""

    def mutation_positions(self, node: parso.tree.NodeOrLeaf) -> Iterator[tuple[object, object]]:
        if self._removable(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: parso.tree.NodeOrLeaf, index: int) -> parso.tree.NodeOrLeaf:
        return parso.python.tree.Keyword("pass", node.start_pos, node.get_first_leaf().prefix)

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()

    def _removable(self, node: parso.tree.NodeOrLeaf) -> bool:
        if node.parent is None or node.parent.type != "simple_stmt":
            return False
        if parso.python.tree.search_ancestor(node, "funcdef") is None:
            return False
        call = node.type in ("power", "atom_expr") and node.children[-1].type == "trailer"
        return bool(call or node.type == "expr_stmt")


def operators() -> dict[str, Operator]:
    """Return the kinds of mutation.

    Of the replacements of one operator by another, those that a person might write by mistake.
    """
    pairs = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "BitAnd_BitOr", "BitOr_BitAnd", "Pow_Mul")
    comparisons = (
        *("Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt"),
        *("Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is"),
    )
    names = (
        *(f"ReplaceBinaryOperator_{pair}" for pair in pairs),
        *(f"ReplaceComparisonOperator_{pair}" for pair in comparisons),
        *(f"ReplaceUnaryOperator_Delete_{name}" for name in ("Not", "USub", "Invert")),
        *("ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
        *("AddNot", "NumberReplacer", "ReplaceBreakWithContinue", "ReplaceContinueWithBreak"),
        "ZeroIterationForLoop",
    )
    known = {name: get_operator(f"core/{name}")() for name in names}
    return {**known, "RemoveStatement": RemoveStatement()}


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        file: That is changed.
        operator: Kind of change.
        occurrence: Number of the place among those in the file.
        line: Where it begins.
    """

    file: str
    operator: str
    occurrence: int
    line: int

    @property
    def key(self) -> str:
        return f"{self.file}:{self.operator}:{self.occurrence}"


def _counted_lines(source: str, names: tuple[str, ...]) -> set[int]:
    """Lines of the named classes and functions, all if there are none."""
    if not names:
        return set(range(1, source.count("\n") + 2))
    found: dict[str, ast.FunctionDef | ast.ClassDef] = {}

    def collect(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                found[prefix + child.name] = child
                collect(child, f"{prefix}{child.name}.")

    collect(ast.parse(source), "")
    if missing := set(names) - set(found):
        raise SystemExit(f"no {', '.join(sorted(missing))} in this file: mend SUBJECTS")
    nodes = [found[name] for name in names]
    return {line for node in nodes for line in range(node.lineno, (node.end_lineno or 0) + 1)}


def _declarations(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Begin and end of all type annotations and decorators: a change of one changes nothing that a robot does."""
    spans = []
    for node in ast.walk(ast.parse(source)):
        hints = [getattr(node, name, None) for name in ("annotation", "returns")]
        for part in (*hints, *getattr(node, "decorator_list", ())):
            if isinstance(part, ast.expr):
                end = (part.end_lineno or 0, part.end_col_offset or 0)
                spans.append(((part.lineno, part.col_offset), end))
    return spans


def mutants(subject: Subject) -> list[Mutant]:
    """Return all mutants of a subject."""
    made = []
    for file, names in subject.code:
        source = (ROOT / file).read_text()
        lines, declared = _counted_lines(source, names), _declarations(source)
        for name, operator in operators().items():
            places = [
                place
                for node in ast_nodes(get_ast(source))
                for place in operator.mutation_positions(node)
            ]
            for occurrence, (begin, _) in enumerate(places):
                if begin[0] in lines and not any(a <= begin < b for a, b in declared):
                    made.append(Mutant(file, name, occurrence, begin[0]))
    return sorted(made, key=lambda mutant: (mutant.file, mutant.line))


def digest(*names: str) -> str:
    """Return a hash of files; of tests in one, of all of it."""
    kept = hashlib.sha256()
    for name in names:
        kept.update((ROOT / name.partition("::")[0]).read_bytes())
    return kept.hexdigest()[:16]


def run_tests(copy: Path, subject: Subject, timeout: float) -> str:
    """Run a subject's tests in a copy; return ``passed``, ``failed`` or ``too long``."""
    # The mutant's own byte code is not kept.
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["--hypothesis-profile", "mutation", "-m", "not whole and not realtime"]
    command += subject.tests
    process = subprocess.Popen(
        command,
        cwd=copy,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return "passed" if process.wait(timeout) == 0 else "failed"
    except subprocess.TimeoutExpired:
        return "too long"
    finally:
        if process.poll() is None:
            os.killpg(process.pid, 9)
            process.wait()


def make_copy(folder: Path) -> Path:
    """Copy what tests need, and compile it."""
    skip = shutil.ignore_patterns(".*", "runs", "*.egg-info", "__pycache__", "build", "dist")
    copy = Path(shutil.copytree(ROOT, folder, symlinks=True, ignore=skip))
    # By time and length a mutant often looks like its source; by its hash it does not.
    compileall.compile_dir(copy, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return copy


def judge(copies: Path, subject: Subject, mutant: Mutant, timeout: float) -> tuple[str, str]:
    """Return the outcome of the tests for a mutant, and its change as a diff."""
    copy = copies / str(os.getpid())
    if not copy.exists():
        make_copy(copy)
    path = copy / mutant.file
    source = path.read_text()
    changed = mutate_code(source, operators()[mutant.operator], mutant.occurrence)
    difference = difflib.unified_diff(source.splitlines(), changed.splitlines(), lineterm="", n=0)
    lines = [line for line in difference if not line.startswith(("---", "+++", "@@"))]
    try:
        path.write_text(changed)
        return run_tests(copy, subject, timeout), "\n".join(lines)
    finally:
        path.write_text(source)


@dataclass(frozen=True)
class Verdict:
    """Outcome of one mutant.

    Attributes:
        source: Hash of the file that it is in.
        tests: Hash of the tests.
        mutant: Its key.
        line: Where it is.
        outcome: ``passed``: it survived; ``failed`` or ``too long``: the tests noticed it.
        change: Its diff.
    """

    source: str
    tests: str
    mutant: str
    line: int
    outcome: str
    change: str


def main() -> int:
    """Judge all mutants; return 1 if a score is below 90 %."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subjects", nargs="*", help="names, by default all")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "mutation.json")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="count mutants, run nothing")
    given = parser.parse_args()
    chosen = [each for each in SUBJECTS if not given.subjects or each.name in given.subjects]
    console = Console()
    if given.list:
        for subject in chosen:
            console.print(f"{subject.name}: {len(mutants(subject))} mutants")
        return 0
    given.out.parent.mkdir(parents=True, exist_ok=True)
    verdicts = _load(given.out)
    table = Table("subject", "mutants", "noticed", "survived", "score [%]")
    enough = True
    with tempfile.TemporaryDirectory() as folder:
        copies = Path(folder)
        for subject in chosen:
            mine = _judge_all(subject, verdicts, copies, given, console)
            survived = [each for each in mine if each.outcome == "passed"]
            score = 100.0 * (1.0 - len(survived) / len(mine))
            enough &= score >= 90.0
            counts = (len(mine), len(mine) - len(survived), len(survived))
            table.add_row(subject.name, *map(str, counts), f"{score:.1f}")
            for each in survived:
                print(f"{each.mutant} line {each.line}\n{each.change}")
    console.print(table)
    return int(not enough)


def _judge_all(
    subject: Subject,
    verdicts: list[Verdict],
    copies: Path,
    given: argparse.Namespace,
    console: Console,
) -> list[Verdict]:
    """Verdicts of all mutants of a subject; new ones are added to ``verdicts`` and kept."""
    selected = mutants(subject)
    sources, tests = {file: digest(file) for file, _ in subject.code}, digest(*subject.tests)
    done = {
        each.mutant: each
        for each in verdicts
        if each.source in sources.values() and (each.outcome != "passed" or each.tests == tests)
    }
    missing = [mutant for mutant in selected if mutant.key not in done]
    if missing:
        begin = time.monotonic()
        if run_tests(make_copy(copies / f"before-{tests}"), subject, 1800.0) != "passed":
            raise SystemExit(f"{subject.name}: the tests fail without any mutant")
        timeout = 10.0 + 4.0 * (time.monotonic() - begin)
        console.print(f"{subject.name}: {len(missing)} mutants, at most {timeout:.0f} s each")
        outcomes = Parallel(n_jobs=given.workers, return_as="generator")(
            delayed(judge)(copies, subject, mutant, timeout) for mutant in missing
        )
        for mutant, (outcome, change) in zip(missing, outcomes, strict=True):
            verdict = Verdict(sources[mutant.file], tests, mutant.key, mutant.line, outcome, change)
            done[mutant.key] = verdict
            verdicts.append(verdict)
            write_text(given.out, json.dumps([asdict(each) for each in verdicts], indent=1))
    return [done[mutant.key] for mutant in selected]


def _load(path: Path) -> list[Verdict]:
    if not path.exists():
        return []
    return [Verdict(**each) for each in json.loads(path.read_text())]


if __name__ == "__main__":
    sys.exit(main())
