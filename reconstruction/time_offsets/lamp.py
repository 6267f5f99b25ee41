"""Time offsets and row times of cameras, measured from a blinking lamp in view.

Rows that are exposing when the lamp switches are lit in part. They show a ramp as long as the exposure (and
the lamp's own rise time), bent by the camera's tone curve. Rising and falling edges bend to opposite sides.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from capture_app.session.format.common_times import REFERENCE
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import MAX_OFFSET_MS, CameraTime, ImageTimes

STEP = 2
"""Images this far apart show the full difference when the lamp switches between them."""
BESIDE = 2
"""Images on each side of a change that show the states before and after it."""
CLEAR = 6.0
"""Minimum ratio of a lamp's brightness change to the other changes of brightness."""
MIN_FRACTION = 0.02
"""Minimum change of brightness by a lamp, as a fraction of the brightness."""
COVERED = 0.5
"""Minimum fraction of an edge's ramp that must be covered by rows that were read out."""
MIN_ROWS = 6
"""Minimum number of rows that show an edge."""
MAX_RESIDUAL = 0.12
"""Maximum RMS residual of an edge from its ramp, as a fraction of its rise."""
RAMP_ERROR = 0.015
"""Error of an edge from a different tone curve or flickering light, as a fraction of its ramp."""
NEAR_MS = 20.0
"""Maximum distance of edges that may be the same after an offset: the gap that images can hide."""
MIN_EDGES = 3
"""Minimum number of common edges; with fewer the error bar is not reliable."""
SLOW_MS = 15.0
"""Maximum rise time of a lamp beyond the exposure; a slower lamp has no edge."""
SYSTEMATIC_MS = 0.02
"""Systematic error of an offset by light; one standard deviation."""
LIGHT = "light"
"""Source name of an offset measured from a lamp."""
NO_LAMP = "it sees no blinking lamp"


Ramp = tuple[float, float]
"""Duration for which rows show an edge, ms, and the exponent of the tone curve."""
EdgeTime = tuple[float, float, float]
"""Time of an edge, ms, the row whose mid-exposure was at that time, and the time's standard deviation, ms."""


@dataclass(frozen=True)
class BlinkEdge:
    """One switching of the lamp, in the rows (n,) that show it in the few images around it.

    `row` counts from the top. `times_ms` are mid-exposure times. `lit` is a row's level from dark (0) to
    bright (1). `sd` is its error.
    """

    rising: bool
    row: Array
    times_ms: Array
    lit: Array
    sd: Array

    @cached_property
    def rough_ms(self) -> float:
        """The time that best splits the rows into unlit before and lit after, or the other way round."""
        order = np.argsort(self.times_ms)
        times_ms, lit = self.times_ms[order], np.clip(self.lit[order], 0, 1)
        lit = lit if self.rising else 1 - lit
        before = np.concatenate([[0], np.cumsum(lit**2)])
        after = np.concatenate([np.cumsum(((1 - lit) ** 2)[::-1])[::-1], [0]])
        best = int((before + after).argmin())
        return float((times_ms[max(0, best - 1)] + times_ms[min(best, len(lit) - 1)]) / 2)

    def every(self, step: int) -> "BlinkEdge":
        """Return the edge in every `step`-th row of the images only."""
        rows = self.row % step == 0
        return BlinkEdge(self.rising, self.row[rows], self.times_ms[rows], self.lit[rows], self.sd[rows])

    def place(self, near: float, half_width: float, ramp: Ramp) -> tuple[float, float]:
        """Return the best-fitting time of the ramp within `half_width` of `near`, and its cost."""
        # An edge is tried at so many times; the parabola below is finer.
        places = near + np.linspace(-1, 1, 61) * half_width
        misses = self.level((self.times_ms[None] - places[:, None]) / ramp[0] + 0.5, ramp) - self.lit[None]
        costs = np.log1p((misses / (3 * self.sd[None])) ** 2).sum(1)
        k = int(costs.argmin())
        place = float(places[k])
        if 0 < k < len(places) - 1:
            a, b, c = costs[k - 1], costs[k], costs[k + 1]
            place += float(0.5 * (a - c) / (a + c - 2 * b) * (places[1] - places[0]))
        return place, float(costs[k])

    def level(self, part: Array, ramp: Ramp) -> Array:
        """Return the level of rows at a given fraction of the ramp."""
        past = np.clip(part, 0, 1)
        return np.asarray(past ** ramp[1] if self.rising else (1 - past) ** ramp[1])


def find_blink_edges(dataset: Dataset, camera: str, rows_ms: Mapping[int, Array]) -> list[BlinkEdge]:
    """Find every switching of a lamp in a camera's images, in order; `rows_ms` are each image's row times."""
    if len(there := dataset.instants(camera)) < 2 * (STEP + BESIDE):
        return []
    changes = _changes(np.array([float(dataset.grey(camera, k).mean()) for k in there]))
    borders = [-BESIDE, *(at for at, _ in changes), len(there) + BESIDE]
    blinks = []
    for (at, rising), before, after in zip(changes, borders, borders[2:], strict=False):
        # Each change shows in the image that it falls into and in both neighbours.
        first, last = at - 1, at + 1
        early = there[max(first - BESIDE, before + 2, 0) : first]
        late = there[last + 1 : min(last + 1 + BESIDE, after - 1)]
        if early and late:
            shown = {k: rows_ms[k] for k in there[first : last + 1]}
            blinks.append(_edge(dataset, camera, rising, shown, early, late))
    return blinks


def _changes(brightness: Array) -> list[tuple[int, bool]]:
    """Return the images in which the brightness (n,) changes lastingly, and whether it rises."""
    steps = np.zeros(len(brightness))
    steps[STEP // 2 : -STEP // 2] = brightness[STEP:] - brightness[:-STEP]
    size = np.abs(steps)
    # With a slow lamp most images change.
    typical = float(np.quantile(size, 0.2)) / 0.253
    threshold = max(CLEAR * typical, MIN_FRACTION * float(np.median(brightness)), 0.5)
    starts: list[int] = []
    for k in map(int, np.flatnonzero(size > threshold)):
        if not starts or steps[k] * steps[starts[-1]] < 0 or k - starts[-1] > STEP + 1:
            starts.append(k)
        elif size[k] > size[starts[-1]]:
            starts[-1] = k
    # A lamp makes equal steps up and down; much smaller steps have another cause.
    typical_step = float(np.median(size[starts])) if starts else 0.0
    return [(k, bool(steps[k] > 0)) for k in starts if size[k] > 0.3 * typical_step]


def _edge(
    dataset: Dataset,
    camera: str,
    rising: bool,
    shown: Mapping[int, Array],
    early: Sequence[int],
    late: Sequence[int],
) -> BlinkEdge:
    dark, bright = (
        np.mean([dataset.grey(camera, k).astype(np.float32) for k in edge], axis=0)
        for edge in ((early, late) if rising else (late, early))
    )
    rise = bright - dark
    # Smaller differences are noise, and white pixels show none.
    usable = (rise > 8) & (bright < 250)
    lit, sd = np.stack([_lit_rows(dataset.grey(camera, k), dark, rise, usable) for k in shown], axis=1)
    known = np.isfinite(lit)
    return BlinkEdge(
        rising, np.nonzero(known)[1], np.stack(list(shown.values()))[known], lit[known], sd[known]
    )


def _lit_rows(image: Array, dark: Array, rise: Array, usable: Array) -> tuple[Array, Array]:
    """Return each row's level (n,) from dark to bright, and its error, without pixels spoiled by motion."""
    over = image.astype(np.float32) - dark
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows without a usable pixel
        lit = np.nanmedian(np.where(usable, over / rise, np.nan), axis=1)
        for _ in range(2):
            miss = np.abs(over - lit[:, None] * rise)
            typical = np.nanmedian(np.where(usable, miss, np.nan), axis=1)
            weights = np.where(usable & (miss < 3 * 1.4826 * typical[:, None] + 1), rise, 0)
            lit = (weights * over).sum(1) / (weights * rise).sum(1)
        # At least 0.01, for mains flicker, image compression and the like.
        sd = np.hypot(0.01, (1.4826 * typical + 1) / np.sqrt((weights * rise).sum(1)))
    shown = (weights > 0).sum(1) >= 12
    return np.where(shown, lit, np.nan), np.where(shown, sd, np.nan)


def fit_ramp(edges: Sequence[BlinkEdge], height: int) -> Ramp:
    """Fit the brightness ramp that all edges share, by at most six of them.

    `height` is the number of rows of the images.
    """
    # More edges hardly improve the ramp.
    chosen = [edges[int(k)] for k in np.linspace(0, len(edges) - 1, min(6, len(edges)))]
    thinned = [(edge.every(max(1, height // 100)), edge.rough_ms) for edge in chosen]

    def residual(ramp: Ramp) -> float:
        return sum(edge.place(near, ramp[0], ramp)[1] for edge, near in thinned)

    best = min((residual(ramp), ramp) for ramp in product(np.geomspace(0.4, 60.0, 28), (0.55, 0.8, 1.1)))
    for finer in (0.1, 0.05, 0.025):
        width, bend = best[1]
        near_by = product(
            (width * (1 + a * finer) for a in (-1, 0, 1)), (bend + b * finer for b in (-2, 0, 2))
        )
        best = min(best, *((residual(ramp), ramp) for ramp in near_by))
    return best[1]


def find_edge_time(edge: BlinkEdge, ramp: Ramp) -> EdgeTime | None:
    """Find when the lamp switched; None if too few rows show the change, or if it is not shaped as a ramp."""
    width_ms = half_width = ramp[0]
    at = edge.rough_ms
    for _ in range(3):
        at, _ = edge.place(at, half_width, ramp)
        half_width /= 10  # to three steps of the search
    part = (edge.times_ms - at) / width_ms + 0.5
    inside = (part > 0) & (part < 1)
    if np.unique(np.floor(part[inside] * 20)).size / 20 < COVERED:
        return None
    miss = (edge.level(part, ramp) - edge.lit)[inside]
    if (residual := float(np.sqrt(np.mean(np.clip(miss, -0.4, 0.4) ** 2)))) > MAX_RESIDUAL:
        return None
    # Change of the rows' levels with a shift, relative to their errors; neighbouring rows share errors.
    # Eight rows share their errors: the height of a block in a compressed image.
    precision = np.sqrt(np.sum((1 / width_ms / np.maximum(edge.sd[inside], residual)) ** 2) / 8)
    row = np.average(edge.row, weights=np.maximum(0, 1 - np.abs(2 * part - 1)))
    return at, float(row), float(np.hypot(1 / precision, RAMP_ERROR * width_ms))


@dataclass(frozen=True)
class SeenLamp:
    """Lamp edges seen by one camera: rough times (ms, its own) and directions of all, exact times of some.

    `row_ms` is the time from row to row. `recorded`: the session records it.
    """

    row_ms: float
    recorded: bool
    height: int
    rough_ms: Array
    rising: Array
    exact: Mapping[int, EdgeTime]
    reason: str


def measure_light_offsets(dataset: Dataset, reference: str | None = None) -> dict[str, CameraTime]:
    """Measure the offset of every camera from a lamp that blinks in view; the reference's offset is 0.

    `reference` None: the camera with the most exactly timed edges.
    """
    seen = {name: see_lamp(dataset, name) for name in dataset.cameras}
    first = reference or max(seen, key=lambda name: len(seen[name].exact))
    if len(seen[first].exact) < MIN_EDGES:
        blinks = f"the lamp does not time {first}: {seen[first].reason}"
        return {name: CameraTime(reason=lamp.reason or blinks) for name, lamp in seen.items()}
    edges = {}
    for name, of in seen.items():
        numbers = _same_edges(seen[first], of)
        exact = {numbers[k]: edge for k, edge in of.exact.items() if k in numbers}
        if len(exact.keys() & seen[first].exact.keys()) >= MIN_EDGES:
            edges[name] = exact
    solved = _solve(first, edges, seen) if len(edges) > 1 else {}
    few = f"it shares fewer than {MIN_EDGES} of the lamp's edges with {first}"
    return {name: solved.get(name) or CameraTime(reason=lamp.reason or few) for name, lamp in seen.items()}


def see_lamp(dataset: Dataset, camera: str) -> SeenLamp:
    """Find all lamp edges in one camera's images; the result has a reason if they cannot be used."""
    rows_ms, row_ms, recorded = _row_times(dataset, camera)
    height = dataset.size(camera)[1]
    found = find_blink_edges(dataset, camera, rows_ms)
    edges = [edge for edge in found if len(edge.row) >= MIN_ROWS]
    exact: dict[int, EdgeTime] = {}
    reason = "too few rows of its pictures show the lamp's light" if found else NO_LAMP
    if edges:
        ramp = fit_ramp(edges, height)
        exposures = [dataset.record(camera, k).exposure_ns for k in rows_ms]
        exposure_ms = (
            float(np.median([exposure for exposure in exposures if exposure] or [dataset.period_ns])) / 1e6
        )
        if ramp[0] > exposure_ms + SLOW_MS:
            reason = f"the lamp takes about {ramp[0]:.0f} ms to light up: it has no edge"
        else:
            exact = {k: at for k, edge in enumerate(edges) if (at := find_edge_time(edge, ramp))}
            few = f"only {len(exact)} of the lamp's edges fall onto its rows; {MIN_EDGES} are needed"
            reason = few if len(exact) < MIN_EDGES else ""
    return SeenLamp(
        row_ms=row_ms,
        recorded=recorded,
        height=height,
        rough_ms=np.array([edge.rough_ms for edge in edges]),
        rising=np.array([edge.rising for edge in edges], bool),
        exact=exact,
        reason=reason,
    )


def _row_times(dataset: Dataset, camera: str) -> tuple[dict[int, Array], float, bool]:
    """Return the mid-exposure times of each image's rows, and the time from row to row, ms.

    Also returns whether the session records them.
    """
    facts, height = dataset.session.camera(camera).facts, dataset.size(camera)[1]
    times, rows = ImageTimes(dataset, (camera,)), np.arange(height)
    rows_ms = {k: times.of_rows_ms(camera, k, rows) for k in dataset.instants(camera)}
    if times.by_rows:
        return rows_ms, (facts.row_time_ns or 0) / 1e6 * facts.height / height, True
    # A readout is assumed to take 0.7 of the period.
    row_ms = 0.7 * dataset.period_ns / 1e6 / height
    return {k: at - row_ms * height / 2 + row_ms * rows for k, at in rows_ms.items()}, row_ms, False


def _same_edges(reference: SeenLamp, other: SeenLamp) -> dict[int, int]:
    """Match another camera's edges to the reference's, by the offset that matches the most edges.

    A lamp that blinks evenly has many such offsets; the smallest one is used.
    """
    gaps = other.rough_ms[:, None] - reference.rough_ms[None]
    same_direction = other.rising[:, None] == reference.rising[None]
    chosen: dict[int, int] = {}
    for lag in sorted(gaps[same_direction & (np.abs(gaps) < MAX_OFFSET_MS)], key=abs):
        distance_ms = np.where(same_direction, np.abs(gaps - lag), np.inf)
        near = {int(k): int(distance_ms[k].argmin()) for k in np.flatnonzero(distance_ms.min(1) < NEAR_MS)}
        if len(near) > len(chosen):
            chosen = near
    return chosen


def _solve(
    first: str, edges: Mapping[str, Mapping[int, EdgeTime]], seen: Mapping[str, SeenLamp]
) -> dict[str, CameraTime]:
    """Solve for the time of every edge and each camera's offset, row time and bend, by least squares.

    The camera's own time of an edge = the edge's - offset - error of the row time * row + bend * direction.
    """
    names = list(edges)
    numbers = sorted({number for own_edges in edges.values() for number in own_edges})
    rows = [
        (camera, number, edge)
        for camera, own_edges in enumerate(edges.values())
        for number, edge in own_edges.items()
    ]
    values, at_rows, sds = np.array([time for _, _, time in rows]).T
    count, spare = len(numbers), len(rows) - len(numbers) - len(names)
    # Relative standard deviations of recorded row times, and of assumed ones.
    row_sds = [0.03 if seen[name].recorded else 0.3 for name in names]
    # Rising edges seem later, and falling ones earlier, by 2 ms (standard deviation).
    priors = np.concatenate([np.zeros(count), *([0.0, 1 / sd**2, 1 / 2**2] for sd in row_sds)])
    design = np.zeros((len(rows), len(priors)))
    for line, (camera, number, _) in enumerate(rows):
        lamp, at = seen[names[camera]], count + 3 * camera
        from_row = at_rows[line] - (0.0 if lamp.recorded else lamp.height / 2)
        direction = 1 if seen[first].rising[number] else -1
        design[line, numbers.index(number)] = 1
        design[line, at : at + 3] = (-1, -lamp.row_ms * from_row, direction)
    priors[count + 3 * names.index(first)] = 1e12
    solution, found_sd = _robust_fit(design, values, np.maximum(sds, SYSTEMATIC_MS), priors, spare)
    solved = {}
    for camera, name in enumerate(names):
        at, row_ns = count + 3 * camera, 1e6 * seen[name].row_ms
        solved[name] = CameraTime(
            offset_ms=0.0 if name == first else float(solution[at]),
            sd_ms=0.0 if name == first else float(np.hypot(found_sd[at], SYSTEMATIC_MS)),
            source=REFERENCE if name == first else LIGHT,
            edges=len(edges[name]),
            row_time_ns=row_ns * (1 + float(solution[at + 1])),
            row_time_sd_ns=row_ns * float(found_sd[at + 1]),
        )
    return solved


def _robust_fit(design: Array, values: Array, sds: Array, priors: Array, spare: int) -> tuple[Array, Array]:
    """Return the best fit and its errors: iteratively reweighted least squares with Cauchy weights."""
    weights = 1 / sds**2
    for _ in range(20):
        normal = design.T @ (weights[:, None] * design) + np.diag(priors)
        solution = np.linalg.solve(normal, design.T @ (weights * values))
        misses = (values - design @ solution) / sds
        scale = max(1.0, 1.4826 * float(np.median(np.abs(misses)) * np.sqrt(len(values) / max(1, spare))))
        weights = 1 / (sds * scale) ** 2 / (1 + (misses / (3 * scale)) ** 2)
    return solution, np.sqrt(np.diagonal(np.linalg.inv(normal)))
