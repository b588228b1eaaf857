"""The table of the fields of a tick, and its users: it has all of a tick, and a new sensor needs no other place."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from pepper_driver.backends.fields import TICK_FIELDS, TRUTH_FIELDS, fields_of
from pepper_driver.controller import Reference
from pepper_driver.observer import JointState, Observation
from support import ROOT


@pytest.mark.parametrize(
    ("part", "owner"), [(Reference, "reference"), (Observation, "observation")]
)
def test_the_table_has_all_of_the_controller_and_of_the_observer(part: type, owner: str) -> None:
    attributes = {field.name for field in fields(part)} - {"contacts"}
    assert {field.attribute for field in fields_of(owner)} == attributes


def test_the_states_of_joints_are_those_of_the_observer() -> None:
    (state,) = (field for field in TICK_FIELDS if field.attribute == "state")
    assert state.meaning == ", ".join(f"{s.value} {s.name.lower()}" for s in JointState)


def test_the_page_on_logs_has_each_field() -> None:
    page = (ROOT / "docs" / "log.md").read_text()
    for field in TICK_FIELDS + TRUTH_FIELDS:
        assert f"`{field.name}`" in page or f"`_{field.attribute}`" in page, field.name


NEW_SENSOR = """
import sys
import types
from importlib.util import find_spec
from pathlib import Path

folder, out = Path(find_spec("pepper_driver.backends").submodule_search_locations[0]), Path(sys.argv[1])
text = (folder / "fields.py").read_text()
for before, new in (
    ("    stale_reason: str = ", "    pressure: FloatArray | None = None\\n"),
    (
        "    _LIMITED,\\n    _F(_O, ",
        "    _F(_M, 'pressure', 'joints', '[Pa]', absent=nan, column='pressure', mirror='size'),\\n",
    ),
):
    assert text.count(before) == 1, before
    text = text.replace(before, new + before)
module = types.ModuleType("pepper_driver.backends.fields")
sys.modules[module.__name__] = module
exec(compile(text, "fields.py", "exec"), module.__dict__)

sys.path.append(sys.argv[2])

from dataclasses import replace

import numpy as np
from support.log_samples import ROBOT, N, Samples

from pepper_driver.backends.replay import ReplayBackend
from pepper_driver.backends.log_file import read_log_file
from pepper_driver.log import LogWriter, read_log
from pepper_driver.log.export import export_log
from pepper_driver.log.schema import layout_metadata
from pepper_driver.loop import TickRecord
from pepper_driver.observer import Recording, RecordingBuilder

assert "[Pa]" in layout_metadata(ROBOT)["fields"]
given = [np.full(N, 1000.0 + k) for k in range(3)]
given[0][ROBOT.joint_index("LElbowRoll")] = 7.0
metadata = {"cycle": "0.012", "response_delay": "1", "identity": "new"}
with LogWriter(out / "run.mcap", ROBOT, metadata) as log:
    for k, pressure in enumerate(given):
        tick = Samples(k).tick(k)
        measurement = replace(tick.measurement, pressure=pressure)
        log.append(TickRecord(tick=replace(tick, measurement=measurement)))
    log.append(TickRecord(tick=Samples(3).tick(3)))
read = read_log(out / "run.mcap")
assert (read["pressure"][:3] == given).all()
assert np.isnan(read["pressure"][3]).all(), "it was not measured"
file = read_log_file(out / "run.mcap")
assert (ReplayBackend(ROBOT, file, "replay://run.mcap").measurements[1].pressure == given[1]).all()
export_log(read, out / "run.csv", "csv")
assert "pressure.LElbowRoll" in (out / "run.csv").read_text().splitlines()[0]
columns = {f.column: np.zeros((3, *read[f.name].shape[1:]), f.type) for f in module.RECORDED_FIELDS}
columns |= {"time": np.arange(3.0), "pressure": np.array(given)}
builder = RecordingBuilder(ROBOT)
for tick in Recording(joint_names=ROBOT.joint_names, **columns).ticks():
    builder.append(tick)
again = builder.finish()
again.save(out / "run.npz")
assert (Recording.load(out / "run.npz").pressure == given).all()
seen = again.mirrored(ROBOT).pressure[0]
assert np.flatnonzero(seen == 7.0).tolist() == [ROBOT.joint_index("RElbowRoll")]
print("found everywhere")
"""


def test_a_new_sensor_is_a_change_of_one_file(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", NEW_SENSOR, str(tmp_path), str(ROOT / "tests")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert run.stdout == "found everywhere\n", run.stderr
