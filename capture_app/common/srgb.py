"""The tone curve of sRGB (IEC 61966-2-1)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_linear(levels: NDArray[Any]) -> NDArray[np.float64]:
    """Return the linear light of levels (0 to 255); 1 is full scale."""
    signal = np.asarray(levels) / 255
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4)
