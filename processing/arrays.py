"""Types of arrays by their elements; shapes are stated where the types are used."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vector = NDArray[np.float64]
"""Floats of shape (n,)."""
Matrix = NDArray[np.float64]
"""Floats of shape (n, m)."""
Singles = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
