"""A lamp's switching on and off in one camera's images: how far each row was lit while it happened."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset

STEP = 2
"""Images so many apart differ fully by a lamp that was switched between them."""
BESIDE = 2
"""So many images to either side of a change show what was before, and what after."""
CLEAR = 6.0
"""A lamp changes brightness by so many times what it otherwise changes by,"""
LEAST_SHARE = 0.02
"""and by at least this share of it."""
LEAST_RISE = 8.0
"""Grey levels by which a pixel must differ to tell anything."""
WHITE = 250
LEAST_SD = 0.01
"""What the mains' flicker, a compressed picture and the like leave of a row's share."""
ROW_PIXELS = 12
"""Fewer pixels of a row that differ tell nothing of it."""


@dataclass(frozen=True)
class BlinkEdge:
    """One change of the lamp, over the few images around it.

    `images` are instants; `lit` (images, rows): how far a row is from dark to bright, NaN where it does not
    show the lamp; `sd` is its error.
    """

    rising: bool
    images: tuple[int, ...]
    lit: Array
    sd: Array


def find_blink_edges(dataset: Dataset, camera: str) -> list[BlinkEdge]:
    """All changes of a lamp that the camera's images show, in order."""
    there = dataset.instants(camera)
    if len(there) < 2 * (STEP + BESIDE):
        return []
    brightness = np.array([float(dataset.grey(camera, k).mean()) for k in there])
    changes = _changes(brightness)
    found = []
    for number, (at, rising) in enumerate(changes):
        before = changes[number - 1][0] if number else -BESIDE
        after = changes[number + 1][0] if number + 1 < len(changes) else len(there) + BESIDE
        # Of each change the image it falls into and those beside it show it.
        first, last = at - 1, at + 1
        early = [k for k in range(first - BESIDE, first) if k > before + 1 and k >= 0]
        late = [k for k in range(last + 1, last + 1 + BESIDE) if k < after - 1 and k < len(there)]
        if early and late and first >= 0 and last < len(there):
            instants = [there[k] for k in range(first, last + 1)]
            edge = _edge(
                dataset, camera, rising, instants, [there[k] for k in early], [there[k] for k in late]
            )
            found.append(edge)
    return found


def _changes(brightness: Array) -> list[tuple[int, bool]]:
    """The images in which the brightness (n,) changes for long, and whether it rises."""
    steps = np.zeros(len(brightness))
    steps[STEP // 2 : -STEP // 2] = brightness[STEP:] - brightness[:-STEP]
    size = np.abs(steps)
    # Of a lamp that is slow most images change.
    usual = float(np.quantile(size, 0.2)) / 0.253
    least = max(CLEAR * usual, LEAST_SHARE * float(np.median(brightness)), 0.5)
    large = size > least
    found: list[tuple[int, bool]] = []
    for k in np.flatnonzero(large):
        rising = bool(steps[k] > 0)
        if found and found[-1][1] == rising and k - found[-1][0] <= STEP + 1:
            if size[k] > size[found[-1][0]]:
                found[-1] = (int(k), rising)
        else:
            found.append((int(k), rising))
    # A lamp makes equal steps up and down; what is much less is something else.
    usual_step = float(np.median([size[k] for k, _ in found])) if found else 0.0
    return [(k, rising) for k, rising in found if size[k] > 0.3 * usual_step]


def _edge(
    dataset: Dataset,
    camera: str,
    rising: bool,
    images: Sequence[int],
    early: Sequence[int],
    late: Sequence[int],
) -> BlinkEdge:
    before, after = (
        np.mean([dataset.grey(camera, k).astype(np.float32) for k in of], axis=0) for of in (early, late)
    )
    dark, bright = (before, after) if rising else (after, before)
    rise = bright - dark
    told = (rise > LEAST_RISE) & (bright < WHITE)
    shares = [_lit_rows(dataset.grey(camera, k), dark, rise, told) for k in images]
    lit, sd = (np.stack(of) for of in zip(*shares, strict=True))
    return BlinkEdge(rising, tuple(images), lit, sd)


def _lit_rows(image: Array, dark: Array, rise: Array, told: Array) -> tuple[Array, Array]:
    """How far each row (n,) is from dark to bright, and the error; without what something moving spoils."""
    over = image.astype(np.float32) - dark
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows without a pixel that tells
        lit = np.nanmedian(np.where(told, over / rise, np.nan), axis=1)
        for _ in range(2):
            miss = np.abs(over - lit[:, None] * rise)
            usual = np.nanmedian(np.where(told, miss, np.nan), axis=1)
            kept = np.where(told & (miss < 3 * 1.4826 * usual[:, None] + 1), rise, 0)
            lit = (kept * over).sum(1) / (kept * rise).sum(1)
        sd = np.hypot(LEAST_SD, (1.4826 * usual + 1) / np.sqrt((kept * rise).sum(1)))
    shown = (kept > 0).sum(1) >= ROW_PIXELS
    return np.where(shown, lit, np.nan), np.where(shown, sd, np.nan)
