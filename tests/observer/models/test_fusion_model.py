from __future__ import annotations

from typing import Any

import pytest

from pepper_driver.config import PepperError
from pepper_driver.observer.models.fusion_model import FusionModelError
from pepper_driver.observer.models.tree import CartTree
from support.fusion import BOUND, MODEL, constant_tree, fusion_model


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weight": (1.1, 0.5)}, "'weight' must lie within 0 and 1"),
        ({"weight": (0.5, -0.1)}, "'weight' must lie within 0 and 1"),
        ({"weight": (float("nan"), 0.5)}, "not finite"),
        ({"spread": (0.0, 0.001)}, "'spread' must be above 0"),
        ({"spread": (0.001, float("inf"))}, "not finite"),
        ({"momentum_bound": 0.0}, "'momentum_bound' must be above 0"),
        ({"momentum_bound": float("nan")}, "'momentum_bound' must be above 0"),
        ({"bound": constant_tree(0.0)}, "'bound' must be above 0"),
        ({"bound": constant_tree(-0.01)}, "'bound' must be above 0"),
    ],
)
def test_values_that_make_no_model_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(FusionModelError, match=message):
        fusion_model(**changes)
    assert issubclass(FusionModelError, PepperError)


def test_the_largest_bound_is_that_of_all_leaves() -> None:
    assert MODEL.max_bound == BOUND
    # The value of a node that is no leaf does not count: here it would be the lowest.
    split = CartTree(
        feature=(0, -1, -1),
        threshold=(0.5, 0.0, 0.0),
        left=(1, -1, -1),
        right=(2, -1, -1),
        value=(0.0, 0.01, 0.03),
    )
    assert fusion_model(bound=split).max_bound == 0.03
