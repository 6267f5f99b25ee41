"""Semi-global matching over a cost volume, row by row in numpy (Hirschmueller 2008)."""

import numpy as np

from reconstruction.common.geometry import Array

BAND = 120


def aggregate_costs(costs: Array, grey: Array, small: int, large: int) -> Array:
    """Sum over 8 paths of the costs with smoothness, int16 like the costs (height x depths x width, uint8).

    `small` is the price of a step by one depth, `large` of any other step, less where `grey` (float32
    height x width) changes from one pixel to the next.
    """
    total = np.zeros(costs.shape, np.int16)
    for way in (1, -1):
        _sweep(costs[::way], total[::way], grey[::way], small, large, (0, 1, -1))
    # Paths along rows do not meet: a band of rows at a time keeps the turned copies small.
    for top in range(0, len(costs), BAND):
        band = slice(top, top + BAND)
        sideways = np.ascontiguousarray(costs[band].transpose(2, 1, 0))
        across = np.zeros(sideways.shape, np.int16)
        flipped = np.ascontiguousarray(grey[band].T)
        for way in (1, -1):
            _sweep(sideways[::way], across[::way], flipped[::way], small, large, (0,))
        for row, line in enumerate(total[band]):
            line += across[:, :, row].T
    return total


def _sweep(costs: Array, total: Array, grey: Array, small: int, large: int, shifts: tuple[int, ...]) -> None:
    rows = len(costs)
    before = [costs[0].astype(np.int16) for _ in shifts]
    for _ in shifts:
        total[0] += costs[0]
    least = np.empty_like(before[0])
    for row in range(1, rows):
        cost, line = costs[row], grey[row]
        for i, shift in enumerate(shifts):
            last, shade = before[i], grey[row - 1]
            if shift:
                last = np.empty_like(least)
                shade = np.roll(shade, shift)
                if shift > 0:
                    last[:, 1:], last[:, 0] = before[i][:, :-1], before[i][:, 0]
                else:
                    last[:, :-1], last[:, -1] = before[i][:, 1:], before[i][:, -1]
            lowest = last.min(0)
            last -= lowest
            jump = np.maximum(large / (1 + np.abs(line - shade) / 8), 1.5 * small).astype(np.int16)
            np.minimum(last, jump, out=least)
            last += small
            np.minimum(least[1:], last[:-1], out=least[1:])
            np.minimum(least[:-1], last[1:], out=least[:-1])
            least += cost
            total[row] += least
            before[i], least = least, (before[i] if shift else last)


def cheapest_depths(total: Array, costs: Array) -> tuple[Array, Array]:
    """Number of each pixel's cheapest depth, between two by a parabola, and the cost that it has itself.

    Both float32 height x width, from volumes of height x depths x width.
    """
    height, count, width = total.shape
    numbers = np.arange(count, dtype=np.int32)[:, None]
    place, own = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for row in range(height):
        line = total[row]
        # Cost and number in one integer: the least of these is far quicker than argmin across rows.
        least = ((line.astype(np.int32) << 9) | numbers).min(0) & 511
        inner = np.clip(least, 1, count - 2)[None]
        before, here, after = (
            np.take_along_axis(line, inner + k, 0)[0].astype(np.float32) for k in (-1, 0, 1)
        )
        part = 0.5 * (before - after) / np.maximum(before - 2 * here + after, 1.0)
        place[row] = inner[0] + np.clip(part, -0.5, 0.5)
        own[row] = np.take_along_axis(costs[row], least[None], 0)[0]
    return place, own
