"""Values of the models of a joint that are refused."""

from __future__ import annotations

from typing import Any

import pytest

from pepper_driver.config import PepperError
from pepper_driver.observer.models.fusion_model import FusionModelError
from support.fusion import fusion_model


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spread": (0.0, 0.001, 0.001)}, "'spread' must be above 0"),
        ({"spread": (0.001, 0.001, -0.001)}, "'spread' must be above 0"),
        ({"spread": (0.001, float("inf"), 0.001)}, "not finite"),
        ({"spread": (0.001, 0.001, float("nan"))}, "not finite"),
        ({"momentum_bound": 0.0}, "'momentum_bound' must be above 0"),
        ({"momentum_bound": float("nan")}, "'momentum_bound' must be above 0"),
    ],
)
def test_values_that_make_no_model_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(FusionModelError, match=message):
        fusion_model(**changes)
    assert issubclass(FusionModelError, PepperError)
