"""Where the sweep's costs and their semi-global scan are made: on the CPU, or on a GPU."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.backends.cost_volume import cost_volume
from reconstruction.depth.backends.semiglobal_aggregation import aggregate_costs, cheapest_depths
from reconstruction.depth.calibrated_image import SourceView


class SweepEngine(Protocol):
    """The two functions in which the CPU and a GPU part; all else of the sweep is one text."""

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Any:
        """Costs as by `cost_volume`, in a form and a memory of the engine's own."""

    def find_cheapest(self, volume: Any, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Place and cost of each pixel's cheapest depth of such costs, after the semi-global scan."""

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """Costs along one surface (height x width, uint8)."""


class CpuEngine:
    """NumPy and OpenCV."""

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Array:
        """Height x depths x width, uint8."""
        return cost_volume(source_views, base, offsets)

    def find_cheapest(self, volume: Array, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """As `cheapest_depths`."""
        return cheapest_depths(aggregate_costs(volume, grey, small, large), volume)

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """As `cost_volume` of one depth."""
        return np.asarray(cost_volume(source_views, inverse_depth, np.zeros(1))[:, 0])


CPU = CpuEngine()
