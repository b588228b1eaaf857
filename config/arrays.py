"""Types of the arrays that all layers exchange."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
ShortArray = NDArray[np.int32]
IndexArray = NDArray[np.intp]
PixelArray = NDArray[np.uint8]
StateArray = NDArray[np.int8]
"""Members of an ``IntEnum``, as logs have them."""
