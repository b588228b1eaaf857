"""Nothing is compiled, or read from the cache of compiled code, once a robot is active."""

import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

PRELUDE = """
from pepper_driver import Comply, Hold, Pepper, Retract
from pepper_driver.config.kernels import Kernel
from pepper_driver.controller import ComTask, PositionTask
from pepper_driver.reflexes import Reflex

active, late, compile_kernel = False, [], Kernel._compile


def spied(kernel):
    if active:
        late.append(kernel.name)
    return compile_kernel(kernel)


Kernel._compile = spied


def use(pepper):
    global active
    wrist = PositionTask("l_wrist", base=True)
    with pepper:
        active = True
        pepper.set_posture({"LShoulderRoll": 0.6, "RElbowRoll": 0.9, "HeadYaw": 0.5}, duration=0.5)
        pepper.run(0.3)
        if "push" in pepper.backend.info.capabilities:
            pepper.push("LBicep", [0.0, 25.0, 0.0], duration=0.5)
            pepper.backend.grab("r_wrist", [0.0, 0.0, 0.05], hold=0.3)
        pepper.run(0.8)
        pepper.add(wrist)
        pepper.add(ComTask(base=True))
        pepper.drive(0.1, 0.0, 0.2)
        pepper.attentive = True
        pepper.run(0.5)
        pepper.remove(wrist)
        pepper.run(0.2)
        active = False
"""


def loaded_late(program: str) -> list[str]:
    """Return the kernels that a program loads while its robot is active, in a process of its own."""
    code = dedent(PRELUDE) + dedent(program) + "\nprint(*late)\n"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    "robot",
    [
        "Pepper('mujoco', reflexes=[Hold(), Comply(), Retract()], log='run.mcap')",
        "Pepper('mujoco://?plant=integral&world=table', observer='momentum')",
        "Pepper('mujoco://?plant=soft-hip', observer='paper')",
        "Pepper('mock', observer=None)",
    ],
)
def test_nothing_is_compiled_while_a_robot_is_active(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert loaded_late(f"use({robot})") == []


def test_a_kernel_that_is_loaded_inside_a_tick_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    kernel = """
        from pepper_driver.config.kernels import kernel

        @kernel
        def double(x: float) -> float:
            return 2.0 * x
        """
    Path("careless.py").write_text(dedent(kernel))
    program = """
        from careless import double

        class Careless(Reflex):
            def step(self, observation, measurement, requests):
                if active:  # not in the dry run
                    double.load()

        use(Pepper('mujoco', reflexes=[Careless()]))
        """
    assert loaded_late(program) == ["careless.double"]
