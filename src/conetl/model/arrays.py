"""Types of numpy arrays. Shapes, units and frames are in the docstrings of the functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
#: (H, W) grey or (H, W, 3) BGR.
Image = NDArray[np.uint8]
