"""How late each camera is against another, and how long its rows take, by a lamp that blinks before them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from capture_app.session.format.row_exposures import row_exposures
from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset
from reconstruction.time_offsets.blink_edges import find_blink_edges
from reconstruction.time_offsets.edge_times import EdgeTime, RowTimes, find_edge_time, fit_ramp, rough_time

REACH_MS = 300.0
"""Offsets up to this are looked for."""
NEAR_MS = 20.0
"""Edges that an offset brings so near to each other may be one: as much as images hide between them."""
LEAST_EDGES = 3
"""With fewer in common there is no error bar that could be believed."""
SLOW_MS = 15.0
"""A lamp that takes longer than this to light up has no edge."""
TOLD_ROWS, UNTOLD_ROWS = 0.03, 0.3
"""How wrong a row time may be, as a share: one that the session tells, and one that is taken for granted."""
USUAL_READOUT = 0.7
"""Of the period, where no row time is told."""
BEND_MS = 2.0
"""By how much rising edges may seem later, and falling ones earlier."""
SYSTEMATIC_MS = 0.02
LIGHT = "light"
"""What an offset was measured by."""
NO_LAMP = "no lamp blinks before it"


@dataclass(frozen=True)
class LightOffset:
    """How much later than its times say the middle of a camera's exposures was, against the reference's.

    Of the first row, or the middle one where the session tells no row time. `offset_ms` and `sd_ms` are None
    where that cannot be told, and `reason` says why; `row_time_ns` is what its pictures tell, with its error.
    """

    offset_ms: float | None = None
    sd_ms: float | None = None
    reason: str = ""
    edges: int = 0
    row_time_ns: float | None = None
    row_time_sd_ns: float | None = None


@dataclass(frozen=True)
class SeenLamp:
    """What one camera saw: rough times (ms, by its own) and directions of all edges, exact ones of some.

    `told`: the session tells its row time.
    """

    rows: RowTimes
    told: bool
    height: int
    rough_ms: Array
    rising: Array
    exact: Mapping[int, EdgeTime]
    reason: str = ""


def measure_light_offsets(dataset: Dataset, reference: str | None = None) -> dict[str, LightOffset]:
    """The offset of every camera, by a lamp that blinks before it; that of the reference is 0.

    `reference` None: the camera that tells most of the lamp's edges.
    """
    seen = {name: see_lamp(dataset, name) for name in dataset.cameras}
    first = reference or max(seen, key=lambda name: len(seen[name].exact))
    if len(seen[first].exact) < LEAST_EDGES:
        blinks = f"the lamp tells nothing of {first}: {seen[first].reason}"
        return {name: LightOffset(reason=of.reason or blinks) for name, of in seen.items()}
    edges = {}
    for name, of in seen.items():
        numbers = _same_edges(seen[first], of)
        exact = {numbers[k]: one for k, one in of.exact.items() if k in numbers}
        if len(exact.keys() & seen[first].exact.keys()) >= LEAST_EDGES:
            edges[name] = exact
    solved = _solve(first, edges, seen) if len(edges) > 1 else {}
    few = f"it shares fewer than {LEAST_EDGES} of the lamp's edges with {first}"
    return {name: solved.get(name) or LightOffset(reason=of.reason or few) for name, of in seen.items()}


def see_lamp(dataset: Dataset, camera: str) -> SeenLamp:
    """All edges of a lamp that one camera's images show; without any, why."""
    rows, told = _row_times(dataset, camera)
    found = find_blink_edges(dataset, camera)
    rough = [(edge, rough_time(edge, rows.of(edge))) for edge in found]
    known = [(edge, at) for edge, at in rough if at is not None]
    seen = SeenLamp(
        rows=rows,
        told=told,
        height=dataset.size(camera)[1],
        rough_ms=np.array([at for _, at in known]),
        rising=np.array([edge.rising for edge, _ in known], bool),
        exact={},
        reason=NO_LAMP,
    )
    if not found:
        return seen
    ramp = fit_ramp([edge for edge, _ in known], rows)
    if ramp is None:
        return replace(seen, reason="too little of its pictures shows the lamp's light")
    exposures = [dataset.record(camera, k).exposure_ns for k in rows.start_ms]
    exposure_ms = float(np.median([one for one in exposures if one] or [dataset.period_ns])) / 1e6
    if ramp.width_ms > exposure_ms + SLOW_MS:
        return replace(
            seen, reason=f"the lamp takes about {ramp.width_ms:.0f} ms to light up: it has no edge"
        )
    exact = {k: at for k, (edge, _) in enumerate(known) if (at := find_edge_time(edge, rows, ramp))}
    few = f"{len(exact)} of the lamp's edges fall onto its rows, and it takes {LEAST_EDGES}"
    return replace(seen, exact=exact, reason="" if len(exact) >= LEAST_EDGES else few)


def _row_times(dataset: Dataset, camera: str) -> tuple[RowTimes, bool]:
    """The middles of its rows' exposures; and whether the session tells them."""
    height = dataset.size(camera)[1]
    epoch_ns = dataset.instants_ns[0]
    record = dataset.session.camera(camera)
    images = {k: dataset.record(camera, k) for k in dataset.instants(camera)}
    known = {k: rows for k, image in images.items() if (rows := row_exposures(record, image)) is not None}
    if images and len(known) == len(images):
        told_ms = (record.facts.row_time_ns or 0) / 1e6
        starts = {k: (rows.middle_ns(0) - epoch_ns) / 1e6 for k, rows in known.items()}
        return RowTimes(starts, told_ms * record.facts.height / height), True
    row_ms: float = USUAL_READOUT * dataset.period_ns / 1e6 / height
    starts = {k: (image.leader_ns - epoch_ns) / 1e6 - row_ms * height / 2 for k, image in images.items()}
    return RowTimes(starts, row_ms), False


def _same_edges(reference: SeenLamp, other: SeenLamp) -> dict[int, int]:
    """Which of the reference's edges each of another camera's is, by the offset that brings most together.

    The least of such offsets: a lamp that blinks evenly has many.
    """
    gaps = other.rough_ms[:, None] - reference.rough_ms[None]
    alike = other.rising[:, None] == reference.rising[None]
    chosen: dict[int, int] = {}
    for lag in sorted(gaps[alike & (np.abs(gaps) < REACH_MS)], key=abs):
        away = np.where(alike, np.abs(gaps - lag), np.inf)
        near = {int(k): int(away[k].argmin()) for k in np.flatnonzero(away.min(1) < NEAR_MS)}
        if len(near) > len(chosen):
            chosen = near
    return chosen


def _solve(
    first: str, edges: Mapping[str, Mapping[int, EdgeTime]], seen: Mapping[str, SeenLamp]
) -> dict[str, LightOffset]:
    """Least squares over all edges: when each was, and of each camera its offset, row time and bend.

    The camera's own time of an edge = the edge's - offset - error of the row time * row + bend * direction.
    """
    names = list(edges)
    numbers = sorted({number for of in edges.values() for number in of})
    count, spare = len(numbers), sum(map(len, edges.values())) - len(numbers) - len(names)
    design = np.zeros((sum(map(len, edges.values())), count + 3 * len(names)))
    values, sds, priors = np.zeros(len(design)), np.zeros(len(design)), np.zeros(design.shape[1])
    line = 0
    for camera, name in enumerate(names):
        of, at = seen[name], count + 3 * camera
        priors[at + 1] = 1 / (TOLD_ROWS if of.told else UNTOLD_ROWS) ** 2
        priors[at + 2] = 1 / BEND_MS**2
        for number, one in edges[name].items():
            from_row = one.row - (0.0 if of.told else of.height / 2)
            direction = 1 if seen[first].rising[number] else -1
            design[line, numbers.index(number)] = 1
            design[line, at : at + 3] = (-1, -of.rows.row_ms * from_row, direction)
            values[line], sds[line] = one.at_ms, max(one.sd_ms, SYSTEMATIC_MS)
            line += 1
    priors[count + 3 * names.index(first)] = 1e12
    found, spread = _robust_fit(design, values, sds, priors, spare)
    solved = {}
    for camera, name in enumerate(names):
        at, row_ns = count + 3 * camera, 1e6 * seen[name].rows.row_ms
        solved[name] = LightOffset(
            0.0 if name == first else float(found[at]),
            0.0 if name == first else float(np.hypot(spread[at], SYSTEMATIC_MS)),
            edges=len(edges[name]),
            row_time_ns=row_ns * (1 + float(found[at + 1])),
            row_time_sd_ns=row_ns * float(spread[at + 1]),
        )
    return solved


def _robust_fit(design: Array, values: Array, sds: Array, priors: Array, spare: int) -> tuple[Array, Array]:
    """What fits best, and its errors: iteratively reweighted least squares with Cauchy weights."""
    weights = 1 / sds**2
    for _ in range(20):
        normal = design.T @ (weights[:, None] * design) + np.diag(priors)
        found = np.linalg.solve(normal, design.T @ (weights * values))
        misses = (values - design @ found) / sds
        freedom = float(np.sqrt(len(values) / max(1, spare)))
        scale = max(1.0, 1.4826 * float(np.median(np.abs(misses))) * freedom)
        weights = 1 / (sds * scale) ** 2 / (1 + (misses / (3 * scale)) ** 2)
    return found, np.sqrt(np.diagonal(np.linalg.inv(normal)))
