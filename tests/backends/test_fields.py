"""The table of the fields of a tick: whole and in order."""

from __future__ import annotations

from dataclasses import fields

import pytest

from pepper_driver.backends.fields import (
    RECORDED_FIELDS,
    TICK_FIELDS,
    TRUTH_FIELDS,
    UNMATCHED_FIELDS,
    Command,
    Imu,
    Measurement,
    TickField,
    fields_of,
)
from pepper_driver.backends.simulated import TruthSample

NOT_LOGGED = {"imu", "stale_reason", "commanded_by_others", "contacts"}


@pytest.mark.parametrize(
    ("part", "owner"),
    [
        (Measurement, "measurement"),
        (Imu, "measurement.imu"),
        (Command, "sent"),
    ],
)
def test_the_table_has_all_that_a_tick_holds(part: type, owner: str) -> None:
    attributes = {field.name for field in fields(part)} - NOT_LOGGED
    assert {field.attribute for field in fields_of(owner)} == attributes


def test_the_table_has_all_of_the_truth() -> None:
    logged = {field.attribute for field in TRUTH_FIELDS if field.owner == "truth"}
    assert logged == {field.name for field in fields(TruthSample)} - NOT_LOGGED


@pytest.mark.parametrize("table", [TICK_FIELDS, UNMATCHED_FIELDS, TRUTH_FIELDS])
def test_rows_need_no_padding(table: tuple[TickField, ...]) -> None:
    assert len({field.name for field in table}) == len(table)
    scalar = [field.shape == "scalar" for field in table]
    assert scalar == sorted(scalar, reverse=True), "scalars come first"
    wide = [field.type in ("float64", "int64") for field in table]
    assert wide == sorted(wide, reverse=True), "wide values come before narrow ones"


def test_each_vector_of_a_recording_has_its_mirror_image() -> None:
    vectors = [field for field in RECORDED_FIELDS if field.shape != "scalar"]
    assert all(field.mirror for field in vectors)
