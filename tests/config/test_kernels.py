"""Kernels: what they compile, for which arguments, and where compiled code is kept."""

import math
import os
import stat
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import (
    CACHE_VARIABLE,
    CHECK_VARIABLE,
    Block,
    Matrix,
    Out,
    Records,
    Strided,
    kernel,
    make_records,
)

COMPILES = "compiles its kernels"


@kernel
def square(x: float) -> float:
    """Return x^2."""
    return x * x


class Spring:
    """A spring with its state."""

    stiffness: float
    turns: int
    broken: bool


LIMIT = 10.0


@kernel
def pull(springs: Out[Records[Spring]], lengths: FloatArray, energy: Out[FloatArray]) -> bool:
    """Pull springs to lengths [m]; return True if one has broken."""
    any_broken = False
    for j in range(len(springs)):
        spring = springs[j]
        energy[j] = 0.5 * spring.stiffness * square(lengths[j])
        spring.turns += 1
        spring.broken = spring.broken or energy[j] > LIMIT
        any_broken = any_broken or spring.broken
    return any_broken


@kernel
def divide(a: float, b: float) -> float:
    return a / b


@kernel
def sum_of_kinds(
    matrix: Matrix[FloatArray], block: Block[FloatArray], column: Strided[FloatArray], n: IntArray
) -> float:
    return float(matrix[1, 2] + block[1, 2, 3] + column[1] + n[0])


def test_a_kernel_over_records_is_the_equation_of_one() -> None:
    springs = make_records(Spring, 3, stiffness=[1.0, 2.0, 400.0], turns=7)
    lengths, energy = np.array([1.0, -2.0, 1.0]), np.zeros(3)
    assert pull.load()(springs, lengths, energy)
    np.testing.assert_array_equal(energy, [0.5, 4.0, 200.0])
    np.testing.assert_array_equal(springs["turns"], 8)
    np.testing.assert_array_equal(springs["broken"], [False, False, True])


def test_records_are_an_array_of_their_values() -> None:
    springs = make_records(Spring, 2, stiffness=3.0)
    springs["stiffness"] += [0.0, 1.0]
    copy = springs.copy()
    springs["stiffness"] = 0.0
    assert copy.shape == (2,)
    assert len(copy) == 2
    assert springs["turns"].dtype == np.int64
    np.testing.assert_array_equal(copy["stiffness"], [3.0, 4.0])


def test_arrays_of_all_kinds_are_arguments() -> None:
    matrix, block = np.arange(6.0).reshape(2, 3), np.arange(24.0).reshape(2, 3, 4)
    assert sum_of_kinds(matrix, block, matrix[:, 0], np.array([7])) == 5.0 + 23.0 + 3.0 + 7


def test_what_is_not_finite_goes_through_as_in_numpy() -> None:
    assert divide(1.0, 0.0) == math.inf
    assert math.isnan(divide(0.0, 0.0))
    energy = np.zeros(1)
    assert not pull(make_records(Spring, 1, stiffness=1.0), np.array([math.nan]), energy)
    assert math.isnan(energy[0])


@pytest.mark.parametrize(
    "lengths",
    [np.zeros(6)[::2], np.zeros(3, np.float32), np.zeros((3, 1)), [0.0, 0.0, 0.0], None],
    ids=["gaps", "float32", "two axes", "list", "None"],
)
def test_other_arguments_are_refused_and_never_compiled(lengths: object) -> None:
    run = pull.load()
    signatures = list(run.signatures)  # type: ignore[attr-defined]
    with pytest.raises(TypeError):
        run(make_records(Spring, 3), lengths, np.zeros(3))  # type: ignore[arg-type]
    assert run.signatures == signatures  # type: ignore[attr-defined]


@pytest.mark.parametrize("checks", [True, False])
def test_without_a_look_at_its_arguments_it_computes_the_same(
    checks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tests let it look all the same."""
    assert os.environ[CHECK_VARIABLE]
    if not checks:
        monkeypatch.delenv(CHECK_VARIABLE)
    run = pull.load_unchecked()
    springs, energy = make_records(Spring, 3, stiffness=[1.0, 2.0, 3.0]), np.zeros(3)
    lengths = np.arange(3.0)
    lengths.setflags(write=False)
    assert run(springs, lengths, energy) == pull(springs.copy(), lengths, np.zeros(3))
    assert energy.tolist() == [0.0, 1.0, 6.0]  # k x^2 / 2
    if checks:
        with pytest.raises(TypeError):
            run(springs, np.zeros(6)[::2], energy)


def test_what_a_kernel_only_reads_may_be_read_only() -> None:
    lengths, energy = np.ones(1), np.zeros(1)
    lengths.setflags(write=False)
    pull(make_records(Spring, 1, stiffness=2.0), lengths, energy)
    assert energy[0] == 1.0
    energy.setflags(write=False)
    with pytest.raises(TypeError):
        pull(make_records(Spring, 1), lengths, energy)


def test_a_kernel_writes_to_nothing_else() -> None:
    @kernel
    def careless(values: FloatArray) -> None:
        values[0] = 1.0

    with pytest.raises(Exception, match="readonly"):
        careless.load()


def test_an_annotation_that_no_kernel_takes_is_named() -> None:
    @kernel
    def texts(names: list) -> None:  # type: ignore[type-arg]
        pass

    with pytest.raises(TypeError, match=r"texts: an argument cannot be .*list"):
        texts.load()


# -- cache --------------------------------------------------------------------------------------------------------

MODULE = """
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Out, kernel
from constants import FACTOR
from helper import half

@kernel
def scale(values: Out[FloatArray]) -> None:
    for j in range(len(values)):
        values[j] = half(FACTOR * values[j])
"""
HELPER = """
from pepper_driver.config.kernels import kernel

@kernel
def half(x: float) -> float:
    return x / 2.0
"""
RUN = """
import numpy as np
from scaling import scale
values = np.ones(1)
scale.load()(values)
print(values[0])
"""


class Program:
    """A small program with kernels of its own, run in new processes with a cache of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        self.write("scaling", MODULE)
        self.write("helper", HELPER)
        self.write("constants", "FACTOR = 6.0")

    def write(self, module: str, text: str) -> None:
        (self.folder / f"{module}.py").write_text(dedent(text))

    def start(self, code: str = RUN, **environment: str) -> "subprocess.Popen[str]":
        paths = [str(self.folder), *(path for path in sys.path if path)]
        return subprocess.Popen(
            [sys.executable, "-c", dedent(code)],
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(paths),
                CACHE_VARIABLE: str(self.cache),
                "NUMBA_BOUNDSCHECK": "0",
                **environment,
            },
        )

    def run(self, code: str = RUN, **environment: str) -> tuple[str, str]:
        """Return what it prints, and what it says."""
        process = self.start(code, **environment)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        return out.strip(), err.strip()


@pytest.fixture
def program(tmp_path: Path) -> Program:
    return Program(tmp_path)


def test_code_is_compiled_once_and_then_read(program: Program) -> None:
    out, said = program.run()
    assert out == "3.0"
    assert COMPILES in said
    assert said.count("\n") == 0, "one line"
    assert stat.S_IMODE(program.cache.stat().st_mode) == 0o700
    assert program.run() == ("3.0", "")


def test_a_change_of_what_the_code_follows_from_compiles_again(program: Program) -> None:
    program.run()
    array = "import numpy\nFACTOR = numpy.int64({})"
    changes = [
        ("constants", "FACTOR = 8.0", "4.0"),
        ("constants", array.format(10), "5.0"),
        ("constants", array.format(12), "6.0"),
        ("helper", HELPER.replace("/ 2.0", "/ 1.0"), "12.0"),
        ("scaling", MODULE.replace("FACTOR * values", "2.0 * FACTOR * values"), "24.0"),
    ]
    for module, text, expected in changes:
        program.write(module, text)
        out, said = program.run()
        assert (out, COMPILES in said) == (expected, True), text


def test_processes_that_compile_at_once_disturb_nothing(program: Program) -> None:
    processes = [program.start() for _ in range(3)]
    for process in processes:
        out, err = process.communicate(timeout=120)
        assert (out.strip(), process.returncode) == ("3.0", 0), err
    assert program.run() == ("3.0", "")


def test_code_of_another_processor_is_left_alone(program: Program) -> None:
    program.run(NUMBA_CPU_NAME="generic")
    out, said = program.run()
    assert (out, COMPILES in said) == ("3.0", True)
    assert program.run(NUMBA_CPU_NAME="generic") == ("3.0", "")
    assert program.run() == ("3.0", "")


def test_checks_of_bounds_have_code_of_their_own(program: Program) -> None:
    program.write("helper", HELPER)
    program.write("scaling", MODULE.replace("values[j] =", "values[j + 1] ="))
    program.run("import scaling; scaling.scale.load()")
    process = program.start(NUMBA_BOUNDSCHECK="1")
    assert "IndexError" in process.communicate(timeout=120)[1]


def test_a_folder_that_cannot_be_made_costs_time_only(program: Program) -> None:
    program.cache.write_text("a file in its place")
    for _ in range(2):
        out, said = program.run()
        assert out == "3.0"
        assert str(program.cache) in said
        assert CACHE_VARIABLE in said
        assert COMPILES in said


@pytest.mark.skipif(os.name != "posix", reason="permissions of Unix")
@pytest.mark.parametrize("where", ["the folder", "its parent"])
def test_a_folder_that_others_can_write_to_is_not_used(program: Program, where: str) -> None:
    program.cache = program.folder / "shared" / "cache"
    program.cache.mkdir(parents=True)
    open_to_all = program.cache if where == "the folder" else program.cache.parent
    open_to_all.chmod(0o777)
    out, said = program.run()
    assert out == "3.0"
    assert f"{open_to_all} can be written by others" in said
    assert not list(program.cache.iterdir())


def test_a_broken_file_costs_time_only(program: Program) -> None:
    program.run()
    for ending, content in (("nbi", b""), ("nbi", b"cut short"), ("nbc", b"cut short")):
        files = list(program.cache.rglob(f"*.{ending}"))
        assert files
        for file in files:
            file.write_bytes(content)
        assert program.run()[0] == "3.0"


def test_importing_a_kernel_does_not_import_numba(program: Program) -> None:
    out, _ = program.run("import sys, scaling; print('numba' in sys.modules)")
    assert out == "False"
