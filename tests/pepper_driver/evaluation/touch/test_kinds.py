"""True kinds of touches: by row of the suites, by time and rise, and near others."""

from typing import Any

import pytest

from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.evaluation.touch.kinds import true_kinds
from pepper_driver.evaluation.touch.records import Touched
from support.evaluation import ROBOT
from support.touch_records import take, touched

SECONDS = 40.0
"""Length of the takes."""


def touch(onset: float, release: float, **changes: Any) -> Touched:
    """A touch on the left arm."""
    return touched(onset, "forearm", release=release, **changes)


ROWS = {
    "even": ("push", "push"),
    "along the axis": ("push", "push"),
    "tap of 0.1 s": ("tap", "collision"),
    "tap of 0.2 s": ("tap", "collision"),
    "touch of 0.5 s": ("push", "push"),
    "touch of 2 s": (None, None),
    "hold of 6 s": ("hold", "hold"),
    "rise of 20 ms": ("push", "collision"),
    "rise of 50 ms": ("push", "collision"),
    "rise of 0.3 s": ("push", "push"),
    "three quick taps": ("tap", "collision"),
    "grip that holds": (None, None),
    "grip that pulls": (None, None),
    "grip that follows": (None, None),
    "handshake": ("grip", "grip"),
    "leading by the hand": (None, None),
    "holding hands while driving": (None, None),
    "hug": ("hold", "hold"),
    "object handed over and taken away": (None, None),
    "two touches on one limb": ("push", "push"),
    "two touches on two limbs": ("push", "push"),
    "since before the start": ("hold", "hold"),
    "table met in motion": (None, None),
}
"""By row, true kinds of a touch with 8 and 20 N, alone on its limb."""


def test_every_row_of_the_suites_has_its_kinds() -> None:
    found = {}
    for row in load_touch_suites(ROBOT).rows:
        rise = row.rise if row.forces else None
        found[row.name] = tuple(
            true_kinds(
                take([touch(10.0, 10.0 + row.duration, row=row.name, rise=rise, force=force)])
            )[0]
            for force in (8.0, 20.0)
        )
    assert found == ROWS


@pytest.mark.parametrize(
    ("seconds", "changes", "kind"),
    [
        (0.24, {}, "tap"),
        (0.26, {}, None),
        (0.44, {}, None),
        (0.46, {}, "push"),
        (1.89, {}, "push"),
        (1.91, {}, None),
        (2.11, {}, "hold"),
        (1.0, {"rise": 0.05, "force": 15.0}, "collision"),
        (1.0, {"rise": 0.05, "force": 14.9}, "push"),
        (1.0, {"rise": 0.06, "force": 30.0}, "push"),
        (1.0, {"rise": None, "force": 30.0}, None),
        # A label may be longer than its touch.
        (0.24, {"row": "log", "rise": None, "force": None}, "tap"),
        (0.64, {"row": "log", "rise": None, "force": None}, None),
        (0.66, {"row": "log", "rise": None, "force": 30.0}, "push"),
        (2.29, {"row": "log", "rise": None, "force": None}, None),
        (2.31, {"row": "log", "rise": None, "force": None}, "hold"),
        # It was not ended.
        (SECONDS - 10.0, {"row": "log", "rise": None, "force": None}, None),
    ],
)
def test_the_true_kind_follows_from_time_and_rise(
    seconds: float, changes: dict[str, Any], kind: str | None
) -> None:
    assert true_kinds(take([touch(10.0, 10.0 + seconds, **changes)], seconds=SECONDS)) == (kind,)


def test_true_kinds_of_touches_near_others() -> None:
    def taps(*onsets: float, **changes: Any) -> list[Touched]:
        return [touch(onset, onset + 0.1, **changes) for onset in onsets]

    def kinds(*touches: Touched) -> tuple[str | None, ...]:
        return true_kinds(take(touches))

    assert kinds(*taps(10.0, 10.4, 10.8, 11.2)) == ("tap", "double tap", None, None)
    assert kinds(*taps(10.0, 10.89)) == ("tap", "double tap")
    assert kinds(*taps(10.0, 10.91)) == ("tap", "tap")
    assert kinds(touch(10.0, 11.0), *taps(11.4)) == ("push", "tap")
    assert kinds(*taps(10.0), *taps(10.4, limb="head")) == ("tap", "tap")
    pair = touch(10.0, 11.0), touch(10.5, 11.5), touch(10.6, 11.1, limb="head")
    assert kinds(*pair) == (None, None, "push")
