"""The nearest and farthest depth of a scene, by small pictures matched over all depths that are possible."""

from collections.abc import Mapping, Sequence

import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import ConsistencyLimits, consistent_and_visible_views
from reconstruction.depth.plane_sweep import Surface, SweepOptions, sweep_planes

WIDTH_PX = 176
MAX_PARALLAX_SHARE = 0.35
"""The nearest thing moves by this share of the picture between two neighbouring cameras."""
MAX_LEVELS = 192
MAX_VIEWS = 6
MIN_PIXELS = 150
MAX_COST = 0.35
LIMITS = ConsistencyLimits(reprojection_px=1.0, relative_depth=0.06)


def find_depth_range(
    images: Mapping[str, CalibratedImage], sources: Mapping[str, Sequence[str]]
) -> tuple[float, float]:
    """Nearest and farthest depth of the scene, in the rig's unit, with a margin.

    Raises:
        BadInputError: no two pictures agree on any depth.
    """
    names = [name for name in images if sources.get(name)]
    chosen = [names[int(i)] for i in np.linspace(0, len(names) - 1, min(MAX_VIEWS, len(names)))]
    chosen = list(dict.fromkeys(chosen))
    needed = dict.fromkeys([*chosen, *(s for name in chosen for s in sources[name])])
    small = {name: images[name].scaled(min(1.0, WIDTH_PX / images[name].view.width)) for name in needed}
    surfaces: dict[str, Surface] = {}
    for name in chosen:
        source_views = [SourceView(small[name], small[other]) for other in sources[name][:3]]
        surfaces[name] = sweep_planes(small[name], source_views, _coarse_levels(source_views), SweepOptions())
    found = [_confirmed_inverse_depths(name, small, surfaces, sources) for name in chosen]
    values = np.concatenate(found) if found else np.zeros(0)
    if len(values) < MIN_PIXELS:
        raise BadInputError(
            "the pictures of this instant have nothing in common that depth could be measured by",
            hint="cameras must see the same things from different places, lit and in focus, "
            "and their calibration must be this rig's",
        )
    low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
    margin = 0.12 * (high - low) + 0.02 * high
    return 1 / (high + margin), 1 / max(low - margin, 0.3 * low)


def _coarse_levels(source_views: Sequence[SourceView]) -> Array:
    reference = source_views[0].reference.view
    bases = [float(np.linalg.norm(source_view.translation)) for source_view in source_views]
    near = MAX_PARALLAX_SHARE * reference.width / (reference.focal * min(bases))
    count = int(np.clip(reference.focal * max(bases) * near, 48, MAX_LEVELS))
    return np.linspace(near * 0.002, near, count)


def _confirmed_inverse_depths(
    name: str,
    small: Mapping[str, CalibratedImage],
    surfaces: Mapping[str, Surface],
    sources: Mapping[str, Sequence[str]],
) -> Array:
    """Inverse depths of a view that another view's surface confirms."""
    surface = surfaces[name]
    others = [(SourceView(small[name], small[o]), found) for o, found in surfaces.items() if o != name]
    count, _ = consistent_and_visible_views(surface, others, LIMITS)
    # Two others where there are three: what moves between the pictures finds one that agrees by chance.
    agreed = count >= (2 if len(others) >= 3 else 1)
    return np.asarray(surface.inverse_depth[agreed & (surface.cost < MAX_COST)])
