"""Optimization of Gaussians against the pictures that a moment's cameras took."""

import ctypes
from dataclasses import replace
from functools import partial

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.worker_pool import worker_count, worker_pool
from reconstruction.depth.compiling import GAUSSIANS
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.seen_moment import Moment
from reconstruction.methods.splat.gaussians import Gaussians, Projected, bands, draw, project

RATES = {"colours": 0.02, "logits": 0.1, "grown": 0.04}
"""Adam's step of each parameter: colours from 0 to 1, opacity's logit, logarithm of the size's factor."""
LIMITS = {"colours": (0.0, 1.0), "logits": (-8.0, 8.0), "grown": (-1.5, 1.0)}
FIRST, LAST = 1.75, 0.25
"""Factors of the first and of the last step: fine texture takes large steps, and noise small ones."""
MIN_OPACITY = 0.05
"""Opacity below which a Gaussian is removed at the end."""
GAP, FREE = 0.5, 0.1
"""Fraction of light that passes a pixel of a gap at the start, and that may pass any other pixel freely."""


def optimize(gaussians: Gaussians, moment: Moment, iterations: int) -> tuple[Gaussians, Array]:
    """Return Gaussians with better colours, opacities and sizes, and which were kept (bool).

    Those that became transparent are removed. Each iteration compares all cameras' pictures, one after the
    other; the loss is the squared difference of colours. Light that passes all Gaussians counts as right in
    gaps and up to `FREE`, and beyond that as the most wrong colour, or else noise would make surfaces ever
    more transparent.
    """
    opacities = np.clip(gaussians.opacities, 1e-3, 1 - 1e-3)
    values = {
        "colours": gaussians.colours.copy(),
        "logits": floats(np.log(opacities / (1 - opacities))),
        "grown": np.zeros(len(gaussians), np.float32),
    }
    parts = worker_count()
    slopes = {name: np.zeros((parts, *one.shape), np.float32) for name, one in values.items()}
    moments = {name: (np.zeros_like(one), np.zeros_like(one)) for name, one in values.items()}
    seen = list(moment.values())
    targets = [floats(camera.colours / 255) for camera in seen]
    orders: list[Array | None] = [None] * len(seen)
    free = dict[int, Array]()
    with worker_pool() as pool:
        for visit, factor in enumerate(np.linspace(FIRST, LAST, iterations * len(seen))):
            at = visit % len(seen)
            view = seen[at].view
            opacities = _sigmoid(values["logits"])
            projected = project(gaussians, view, values["grown"], pool, orders[at])
            orders[at] = projected.order
            drawn, passes = draw(projected, values["colours"], opacities, pool, parts)
            if at not in free:
                free[at] = floats(np.where(passes > GAP, 1, FREE))
            errors = _add_background(drawn, passes, free[at], targets[at])
            add = partial(add_slopes, projected, (opacities, values["colours"]), (drawn, errors, passes))
            list(pool.map(add, zip(*slopes.values(), strict=True), bands(view.height, parts)))
            slopes["logits"] *= opacities * (1 - opacities)
            for name, one in values.items():
                _adam(name, one, slopes[name], moments[name], visit + 1, factor)
    opacities = _sigmoid(values["logits"])
    grown = np.exp(values["grown"])[:, None]
    better = replace(
        gaussians, colours=values["colours"], opacities=opacities, sizes=floats(gaussians.sizes * grown)
    )
    visible = opacities >= MIN_OPACITY
    return better.chosen(visible), visible


def _add_background(drawn: Array, passes: Array, free: Array, target: Array) -> Array:
    """Return twice the errors of a drawn picture; add to it the colours that more passing light would add."""
    light, opposite = passes[..., None], floats(target < 0.5)
    excess = np.maximum(light - free[..., None], 0)
    errors = 2 * (drawn + (light - excess) * target + excess * opposite - target)
    drawn += light * np.where(excess > 0, opposite, target)
    return floats(errors)


def add_slopes(
    projected: Projected,
    values: tuple[Array, Array],
    seen: tuple[Array, Array, Array],
    slopes: tuple[Array, ...],
    rows: tuple[int, int],
) -> None:
    """Add the slopes of the loss by colour, opacity and logarithm of the size, from a band of rows.

    `values` are the Gaussians' opacities and colours, `seen` the drawn picture, twice its errors, and the
    light that passes.
    """
    drawn, errors, passes = seen
    call_kernel(
        "gaussian_gradients",
        *(len(projected.order), projected.order, projected.flat, *values),
        *(projected.view.width, *rows, drawn, errors, np.empty_like(passes), passes),
        *slopes,
        source=GAUSSIANS,
    )


def _adam(
    name: str, values: Array, slopes: Array, moments: tuple[Array, Array], iteration: int, factor: float
) -> None:
    """Change values by their slopes (parts x values), which become 0, with `factor` times the usual step."""
    rate = ctypes.c_float(factor * RATES[name] / (1 - 0.9**iteration))
    root = ctypes.c_float(1 / np.sqrt(1 - 0.99**iteration))
    low, high = map(ctypes.c_float, LIMITS[name])
    size = ctypes.c_long(values.size)
    call_kernel(
        "adam_step",
        *(ctypes.c_long(0), size, len(slopes), size, slopes, rate, root, low, high, *moments, values),
        source=GAUSSIANS,
    )


def _sigmoid(logits: Array) -> Array:
    return floats(1 / (1 + np.exp(-logits)))
