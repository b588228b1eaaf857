from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.observer.models.tree import CartTree, TreeError
from support.observer import AFFINE

CART = CartTree(
    feature=(0, 1, -1, -1, -1),
    threshold=(0.5, -1.0, 0.0, 0.0, 0.0),
    left=(1, 2, -1, -1, -1),
    right=(4, 3, -1, -1, -1),
    value=(0.0, 0.0, 10.0, 20.0, 30.0),
)


@pytest.mark.parametrize(
    ("sample", "value"),
    [
        ((0.5, -1.0, 0.0), 10.0),  # on both thresholds: left
        ((0.5, -0.9, 0.0), 20.0),
        ((0.6, -2.0, 0.0), 30.0),
    ],
)
def test_cart_walks_to_the_leaf(sample: tuple[float, float, float], value: float) -> None:
    assert CART.predict(np.array([sample]))[0] == value
    assert CART.leaves == 3


@pytest.mark.parametrize(
    ("sample", "value"),
    [
        ((0.25, 3.0, 1.0), 0.1 + 2.0 * 0.25 + 0.5),
        ((1.0, 2.0, -2.0), -0.3 + 1.0 + 4.0 * 2.0),
        ((1.0, 2.0, 1.0), 0.2 - 2.0 + 3.0),
        ((9.0, -99.0, 9.0), 0.2 + 10.0 + 15.0),  # clamped to (2, -10, 5)
        ((-9.0, 0.0, -9.0), 0.1 - 4.0 - 2.5),  # clamped to (-2, 0, -5)
    ],
)
def test_affine_evaluates_the_function_of_the_leaf(
    sample: tuple[float, float, float], value: float
) -> None:
    assert AFFINE.predict(np.array([sample]))[0] == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
def test_bad_values_raise_nothing(value: float) -> None:
    for tree in (CART, AFFINE):
        tree.predict(np.where(np.eye(3, dtype=np.bool_), value, 0.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"left": (0, 2, -1, -1, -1)}, "node 0 of 5 has child 0"),
        ({"left": (1, 0, -1, -1, -1)}, "node 1 of 5 has child 0"),
        ({"right": (5, 3, -1, -1, -1)}, "node 0 of 5 has child 5"),
        ({"right": (4, -1, -1, -1, -1)}, "node 1 of 5 has child -1"),
        ({"right": (3, 3, -1, -1, -1)}, "no parent, or two"),
        ({"left": (1, 2, -1, 4, -1)}, "leaf 3 has children"),
        ({"feature": (3, 1, -1, -1, -1)}, "node 0 splits on feature 3"),
        ({"feature": (-2, 1, -1, -1, -1)}, "node 0 splits on feature -2"),
        ({"feature": (0, 1, -1, -1)}, "'threshold' has 5 entries for 4 nodes"),
        ({"threshold": (0.0,) * 4}, "'threshold' has 4 entries for 5 nodes"),
        ({"left": (1,)}, "'left' has 1 entries"),
        ({"value": (1.0,) * 6}, "'value' has 6 entries"),
        ({"threshold": (math.nan, -1.0, 0.0, 0.0, 0.0)}, "threshold is not finite"),
        ({"value": (math.inf, 0.0, 10.0, 20.0, 30.0)}, "value is not finite"),
        (
            {"feature": (), "threshold": (), "left": (), "right": (), "value": ()},
            "needs a node",
        ),
    ],
)
def test_refuses_arrays_that_are_no_tree(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(TreeError, match=message):
        replace(CART, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coefficients": AFFINE.coefficients[:4]}, "'coefficients' has 4 entries"),
        (
            {"coefficients": ((math.nan, 0.0, 0.0, 0.0), *AFFINE.coefficients[1:])},
            "coefficient is not finite",
        ),
        ({"lower": (0.0, -math.inf, 0.0)}, "bound is not finite"),
        ({"upper": (-3.0, 10.0, 5.0)}, "above upper"),
    ],
)
def test_refuses_affine_leaves_that_make_no_sense(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(TreeError, match=message):
        replace(AFFINE, **changes)
