"""From light to a picture: vignetting, the sensor's noise, a filmic curve."""

import functools

import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.scenes.meshes import Floats

_STEPS = 8192
_WHITE = 6.0
"""Linear light that the table ends at."""


@functools.cache
def _curve() -> NDArray[np.uint8]:
    """8-bit values of linear light 0 to _WHITE: Narkowicz's fit of the ACES film curve, then sRGB."""
    light = np.linspace(0, _WHITE, _STEPS)
    tone = np.clip(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0, 1)
    srgb = np.where(tone <= 0.0031308, 12.92 * tone, 1.055 * tone ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * srgb), np.uint8)


@functools.cache
def _vignette(height: int, width: int) -> Floats:
    y, x = np.mgrid[:height, :width]
    distance = ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / (width**2 + height**2) * 4
    return np.asarray((1 - 0.26 * distance)[..., None], np.float32)


def develop(light: Floats, exposure_ns: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """BGR uint8 picture of linear light (H, W, 3) as a sensor with automatic gain takes it.

    Shorter exposures need more gain and are noisier: photon noise goes with its square root.
    """
    seen = light * _vignette(light.shape[0], light.shape[1])
    gain = float(np.clip(np.sqrt(8e6 / max(exposure_ns, 1)), 0.5, 2.5))
    deviation = gain * np.sqrt(0.00012 * np.maximum(seen, 0.0) + 0.000006)
    seen = seen + deviation * rng.standard_normal(seen.shape, dtype=np.float32)
    index = np.clip(seen * ((_STEPS - 1) / _WHITE), 0, _STEPS - 1).astype(np.int32)
    return np.asarray(_curve()[index])
