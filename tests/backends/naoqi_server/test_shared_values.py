"""The table between robot process and its readers: whole samples, whatever happens to who writes."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest

from pepper_driver.backends.naoqi_server.dcm import DcmClock
from pepper_driver.backends.naoqi_server.shared_values import KEPT_CYCLES, Table
from pepper_driver.config import load_robot
from support.waiting import PATIENCE

ROBOT = load_robot()
KEYS = 600

WRITER = """
import sys
from pepper_driver.backends.naoqi_server.shared_values import Table
from pepper_driver.config import load_robot
import numpy as np, time
table = Table(int(sys.argv[1]), 200_000, load_robot())
values = np.zeros(200_000)
while True:
    values += 1.0
    table.publish(values)
    if values[0] % 4 == 0:
        time.sleep(0.001)
"""


@pytest.fixture
def file() -> Iterator[int]:
    file = Table.make_file()
    yield file
    os.close(file)


def row(number: int) -> tuple[object, ...]:
    joints, wheels = np.full(17, float(number)), np.zeros(3)
    state = (joints, wheels, wheels, joints, joints, wheels, wheels)
    return (number, number, number * 10**9, number * 10**9, number, 0, *state)


def test_what_is_published_is_read_by_another_mapping(file: int) -> None:
    writer, reader = Table(file, KEYS, ROBOT), Table(file, KEYS, ROBOT)
    clock = DcmClock(begin=123, origin=2**31 - 5)
    writer.start(clock, {"plant": "nominal"})
    assert reader.count == 0
    for number in range(5):
        writer.publish([float(place + number) for place in range(KEYS)])
        np.testing.assert_array_equal(reader.read(), np.arange(KEYS) + number)
    assert (reader.clock, reader.info, reader.count) == (clock, {"plant": "nominal"}, 5)


def test_a_sample_is_of_one_cycle_while_another_process_writes(file: int) -> None:
    reader = Table(file, 200_000, ROBOT)  # so many that reading takes as long as writing
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(file)], pass_fds=[file])
    try:
        end = time.monotonic() + PATIENCE
        while reader.count < 10 and time.monotonic() < end:
            time.sleep(0.01)
        seen = set()
        for read in count():
            values = reader.read()
            assert values.min() == values.max()
            seen.add(values[0])
            if read >= 1000 and len(seen) > 10:
                break
            assert time.monotonic() < end, "the writer was not at work"
    finally:
        writer.kill()
        writer.wait()
    values = reader.read()
    assert values.min() == values.max()


def test_a_writer_that_stopped_in_the_middle_blocks_no_reader(file: int) -> None:
    writer = Table(file, 2, ROBOT)
    writer.publish([1.0, 1.0])

    class Stop(Exception):
        pass

    class Values:
        def __array__(self, *_: object, **__: object) -> np.ndarray:
            raise Stop

    with pytest.raises(Stop):
        writer.publish(Values())  # type: ignore[arg-type]
    np.testing.assert_array_equal(Table(file, 2, ROBOT).read(), [1.0, 1.0])


def test_the_black_box_keeps_the_last_cycles(file: int) -> None:
    writer, reader = (Table(file, KEYS, ROBOT, kept=10) for _ in range(2))
    assert len(reader.black_box()) == 0
    for number in range(7):
        writer.record(row(number))
    assert reader.black_box().cycle.tolist() == list(range(7))
    assert reader.black_box(3).cycle.tolist() == [4, 5, 6]
    for number in range(7, 35):
        writer.record(row(number))
    kept = reader.black_box()
    assert kept.cycle.tolist() == list(range(26, 35)), "the next row to be written does not count"
    assert kept.begin.tolist() == kept.cycle.tolist()
    assert kept.position[:, 16].tolist() == kept.cycle.tolist()
    assert reader.black_box(1).orders.tolist() == [34]


def test_two_minutes_are_kept() -> None:
    assert KEPT_CYCLES * ROBOT.cycle >= 120.0
