"""Types of arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: What networks read and write.
Singles = NDArray[np.float32]
#: Of any precision.
Reals = NDArray[np.floating[Any]]
#: Of any size.
Integers = NDArray[np.integer[Any]]
Bools = NDArray[np.bool_]
#: Pixels (height, width, 3).
Picture = NDArray[np.uint8]
#: Also of records.
AnyArray = NDArray[Any]
