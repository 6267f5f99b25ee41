"""Dense optical flow, by which the speed of what moves is measured."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array


def dense_flow(a: Array, b: Array) -> Array:
    """Optical flow (DIS) from a to b, grey pictures of 0 to 255: float32 height x width x 2, px."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    first, second = (np.clip(image, 0, 255).astype(np.uint8) for image in (a, b))
    return np.asarray(flow.calc(first, second, None))
