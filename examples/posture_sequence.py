"""Plays motions written in YAML: a shipped one, and one of your own. Run: python examples/posture_sequence.py."""

from pathlib import Path
from tempfile import TemporaryDirectory

from pepper_driver import Pepper

BACKEND = "mujoco"
NOD = """
schema: 2
name: nod
steps:
  - repeat:
      times: 2
      steps:
        - {name: down, duration: 0.8, joints: {HeadPitch: 0.2}}   # [s], [rad]
        - {name: up, duration: 0.8, joints: {HeadPitch: -0.3}}
"""

with Pepper(BACKEND, observer=None) as pepper, TemporaryDirectory() as folder:
    report = pepper.play("stretch", on_step=print)  # each step says how far off it ended
    print(f"{report.name}: {'all reached' if report.reached else 'a step was not reached'}")

    path = Path(folder) / "nod.yaml"
    path.write_text(NOD)
    print(pepper.play(path))
