"""Constants have the values of the page on which each has its sensitivity."""

import math
import re

import pytest

from pepper_driver.config.settings import load_observer_settings
from pepper_driver.observer import constants
from support import ROOT

ROW = re.compile(r"^\| `(?P<name>\w+)` (?P<value>[\d.]+)(?P<unit> deg)?\b", re.MULTILINE)
CONSTANTS = {name: float(vars(constants)[name]) for name in vars(constants) if name.isupper()}


def documented() -> dict[str, float]:
    """Values of docs/observer.md by name, in radians."""
    page = (ROOT / "docs" / "observer.md").read_text()
    part = page.partition("### Half and twice each constant")[2].partition("\n## ")[0]
    return {
        row["name"]: math.radians(float(row["value"])) if row["unit"] else float(row["value"])
        for row in ROW.finditer(part)
    }


def test_there_are_25_at_most() -> None:
    assert len(CONSTANTS) <= 25


def test_each_constant_has_its_value_and_sensitivity_on_the_page() -> None:
    settings = vars(load_observer_settings())
    found = documented()
    values = {name: CONSTANTS.get(name, settings.get(name)) for name in found}
    assert set(CONSTANTS) <= set(found)
    assert values == pytest.approx(found)
