"""The same file does the same in simulation, paced or not, and over the stand-in. All files: benchmarks/parity.py."""

import copy
import json
import re
import runpy
import sys
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.observer import Contact
from pepper_driver.realtime import priority_obstacle
from support import ROOT
from support.stand_ins import PATIENT, patient_driver

SCRIPT = ROOT / "benchmarks" / "parity.py"
PARITY = runpy.run_path(str(SCRIPT))
SIDE = runpy.run_path(str(SCRIPT.with_name("parity_side.py")))
SHORT = ("feel_a_push", "retract")
"""An example and an experiment with a push and a reflex each."""


def played(program: Path, world: str, **options: Any) -> dict[str, Any]:
    """Results of a run, as the script reads them."""
    result: dict[str, Any] = json.loads(json.dumps(asdict(SIDE["play"](program, world, **options))))
    return result


@cache
def simulated(name: str) -> dict[str, Any]:
    return played(PARITY["PROGRAMS"][name], "sim")


def differences(*results: dict[str, Any]) -> list[str]:
    found: list[str] = PARITY["compare"](results)
    return found


# -- the short form -------------------------------------------------------------------------------------------------


@pytest.mark.whole
@pytest.mark.parametrize("name", SHORT)
def test_in_real_time_it_is_the_same(name: str) -> None:
    result = played(PARITY["PROGRAMS"][name], "paced")
    assert differences(simulated(name), result) == []
    assert [len(run["contacts"]) for run in result["runs"]] == [1]


@pytest.mark.whole
@pytest.mark.parametrize("name", SHORT)
def test_over_naoqi_it_is_the_same(qi: object, name: str) -> None:
    with patient_driver():
        result = played(PARITY["PROGRAMS"][name], "stand-in", safety=PATIENT)
    found = differences(simulated(name), result)
    obstacle = priority_obstacle()
    if found and obstacle and (overload := PARITY["overload"](result)):
        pytest.skip(f"{overload}; {obstacle}")
    assert found == []
    assert [run["truth"] for run in result["runs"]] == [False]


# -- what the suite finds -------------------------------------------------------------------------------------------


EXAMPLE = """
from pepper_driver import Hold, Pepper
pepper = Pepper("mujoco://?plant=integral", reflexes=[Hold()])
@pepper.on_contact()
def touched(contact): pass
@pepper.on_reflex(phase=None)
def reflex(event): pass
ticks = []
with pepper:
    pepper.run(1.5, on_tick=lambda tick, _: ticks.append(tick))
    pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.5)
    pepper.run(0.5)
"""


@pytest.fixture
def example(tmp_path: Path) -> Path:
    path = tmp_path / "example.py"
    path.write_text(EXAMPLE)
    return path


def test_calls_are_counted(example: Path) -> None:
    result = played(example, "sim")
    assert result["error"] == ""
    assert [(c["name"], c["calls"]) for c in result["callbacks"]] == [
        ("touched", 1),
        ("reflex", 1),
        ("<lambda>, in ticks", 125),
    ]
    assert PARITY["own_faults"](result) == []


@pytest.mark.parametrize(("times", "text"), [(0, "was not called for"), (2, "once more for")])
def test_a_callback_that_is_not_called_once_is_found(
    example: Path, monkeypatch: pytest.MonkeyPatch, times: int, text: str
) -> None:
    publish = Dispatcher.publish

    def broken(self: Dispatcher, event: Any) -> None:
        for _ in range(times if isinstance(event, Contact) else 1):
            publish(self, event)

    monkeypatch.setattr(Dispatcher, "publish", broken)
    (found,) = PARITY["own_faults"](played(example, "sim"))
    assert found.startswith(f"touched {text}" if times == 0 else "touched was called once more for")


def test_an_example_that_fails_is_found(tmp_path: Path) -> None:
    path = tmp_path / "example.py"
    path.write_text("from pepper_driver import Pepper\nPepper().run(1.0)\n")
    result = played(path, "sim")
    (found,) = PARITY["own_faults"](result)
    assert found.startswith("ended with BackendError")
    assert differences(result, result) == ["sim: " + found] * 2


def changed(result: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    other = copy.deepcopy(result)
    other["world"] = "other"
    run = other["runs"][0]
    if key == "onset":
        run["contacts"][0]["onset"] += value
    elif key == "limb":
        run["contacts"][0]["limb"] = value
    elif key in run:
        run[key] = value
    else:
        other[key] = value
    return other


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("onset", 0.11, "contact 0 on left_arm begins 0."),
        ("onset", -0.11, "contact 0 on left_arm begins -0."),
        ("limb", "trunk", "run 0: limbs of contacts: ['trunk'], not ['left_arm']"),
        ("contacts", [], "run 0: limbs of contacts: [], not ['left_arm']"),
        ("reflexes", ["hold end", "hold begin"], "run 0: reflexes"),
        ("sensors", ["Head/Touch/Middle begin"], "run 0: sensors"),
        ("faults", ["stale"], "run 0: faults"),
        ("marks", [], "run 0: marks"),
        ("outcomes", ["run: ended by until"], "the calls of the facade"),
        ("callbacks", [], "calls of callbacks"),
        ("runs", [], "number of runs: 0, not 1"),
        ("error", "ValueError: none", "ended with ValueError: none"),
    ],
)
def test_what_differs_is_found(key: str, value: object, text: str) -> None:
    (found,) = differences(simulated("feel_a_push"), changed(simulated("feel_a_push"), key, value))
    assert (
        found.removeprefix("other: ")
        .removeprefix("run 0: ")
        .startswith(text.removeprefix("run 0: "))
    )


def test_what_noise_decides_is_no_difference() -> None:
    first = simulated("feel_a_push")
    for key, value in (
        ("onset", 0.09),
        ("onset", -0.09),
        ("rebounds", 3),
        ("ticks", 1),
        ("truth", False),
    ):
        assert differences(first, changed(first, key, value)) == []


def test_a_machine_that_was_too_slow_is_named() -> None:
    first = simulated("feel_a_push")
    assert PARITY["overload"](first) == ""
    for key, value in (("missed", 30), ("max_age", 0.2), ("error", "SlowLinkError: 40 ms")):
        assert "too slow" in PARITY["overload"](changed(first, key, value))


def test_a_process_of_its_own_gives_the_same_bits() -> None:
    path = PARITY["PROGRAMS"]["feel_a_push"]
    assert PARITY["play"](path, "sim") == simulated("feel_a_push")


@pytest.mark.parametrize(("change", "code"), [(0.0, 0), (0.2, 1)])
def test_the_exit_code_says_if_it_is_the_same(
    change: float,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    first = simulated("feel_a_push")
    other = changed(first, "onset", change)
    results = {"sim": first, "paced": other}
    main, file = PARITY["main"], tmp_path / "results.json"
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setitem(main.__globals__, "play", lambda _, world: results[world])
    arguments = ["--only", "feel_a_push", "--worlds", "sim,paced", "--json", str(file)]
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
    assert main() == code
    shown, document = capsys.readouterr().out, json.loads(file.read_text())
    later = re.search(r"begins 0\.\d{3} s", shown) is not None
    assert ("feel_a_push: same" in shown, later) == (code == 0, code == 1)
    assert "what differs by nature" in shown
    assert document["same"] == (code == 0)
    assert document["programs"]["feel_a_push"]["worlds"] == [first, other]


def test_the_documentation_has_the_same_table() -> None:
    page = (ROOT / "docs" / "parity.md").read_text()
    for what, cells in PARITY["BY_NATURE"].items():
        assert f"| {' | '.join((what, *cells))} |" in page


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--only", "feel_a_pusch"], "feel_a_push"),
        (["--worlds", "sim,pace"], "paced"),
        (["--worlds", "sim"], "two"),
        (["--worlds", "sim,sim"], "two"),
        (["--json", "no/such/folder/results.json"], "no/such/folder"),
    ],
)
def test_wrong_options_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    shown = capsys.readouterr()
    assert (stopped.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert word in shown.err
