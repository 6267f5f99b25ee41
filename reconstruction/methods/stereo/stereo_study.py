"""Depth of one pair of cameras at every usable instant, and pictures of one instant."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np

from reconstruction.common.drawing import (
    EMPTY,
    box_around,
    colour_depth,
    display_range,
    draw_rows,
    enlarge_crop,
    mark_moving,
    side_by_side,
)
from reconstruction.common.geometry import Array
from reconstruction.common.worker_pool import worker_pool
from reconstruction.method.score import Context, Score
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.method.tally import CONDITIONS, Measurements, Tally, measure_depth
from reconstruction.method.truth import (
    TOLERANCE_TEXT,
    median_still_depth,
    project_into_other,
    right_depth,
    still_pixels,
    true_depth_in_unit,
)
from reconstruction.method.words import read_words
from reconstruction.methods.stereo.stereo_method import Stereo
from reconstruction.methods.stereo.stereo_pair import (
    DepthMap,
    StereoPair,
    epipolar_errors,
)
from reconstruction.methods.stereo.stereo_run import prepare_pair
from reconstruction.scene.conditions import SYNCHRONIZED, Condition


@dataclass(frozen=True)
class StereoInstant:
    """Depth by condition (`synced`, `offset`), and the measured pixels (bool, reference view).

    `truth` is in the calibration's unit, NaN = unknown; None if there is no truth.
    """

    now: int
    shown: dict[str, int]
    """The instant that the second camera shows in each condition."""
    maps: dict[str, DepthMap]
    moving: Array
    static: Array
    truth: Array | None
    matcher: StereoPair


def _draw(one: StereoInstant, side: str, photo: Array, other: Array) -> dict[str, Array]:
    box = box_around(one.moving, max_fraction=0.65)
    depth = one.maps[side].depth
    coloured = colour_depth(depth, *display_range(one.maps["synced"].depth, one.moving))
    right = depth > 0 if one.truth is None else (depth > 0) & right_depth(depth, one.truth)
    return {
        "stereo_late": other,
        "stereo_depth": coloured,
        "stereo_movers": mark_moving(photo, one.moving, right),
        "stereo_closeup": side_by_side(enlarge_crop(photo, box), enlarge_crop(coloured, box, smooth=False)),
        "stereo_pair": _draw_pair(one, photo, other),
    }


def _draw_pair(one: StereoInstant, photo: Array, other: Array) -> Array:
    """Draw both rectified images, in which a point has the same row, with lines for comparison."""
    canvas = one.matcher.rectification
    a, seen = canvas.remap(photo)
    b, seen_b = canvas.remap(other, other=True)
    on, _ = canvas.remap(one.moving.astype(np.uint8), nearest=True)
    a[~seen], b[~seen_b] = EMPTY, EMPTY
    rows, columns = (np.nonzero(seen.mean(axis) > 0.5 * seen.mean(axis).max())[0] for axis in (1, 0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    a, b, on = (np.ascontiguousarray(image[part][:, :: -1 if canvas.mirror else 1]) for image in (a, b, on))
    _, top, _, bottom = box_around(on > 0, spare=0.0, min_px=8)
    return draw_rows(a, b, [int(y) for y in np.linspace(top, bottom, 3)] if on.any() else [])


class StereoStudy(Score):
    """Depth of a pair, synchronized and offset; synchronized images determine what both share."""

    of_pair = True
    needs_calibration = True
    min_cameras = 2

    text = read_words(__package__)
    Options = Stereo
    measures_delay = True

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._projected = lru_cache(maxsize=1)(self._project_still)

    def prepare(self) -> None:
        """Choose the pair.

        Raises:
            ValueError: no two cameras are suitable, or one of them has no calibration.
        """
        self.use_pair(self.compared.choose_stereo_pair(self.asked, self.context.middle))

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[None]:
        """Compare a condition at its instants; see `Score.compare`."""
        pairs, offsets_ms = self.instant_pairs(condition)
        return self.compare_instants(pairs, condition, offsets_ms, folder=folder)

    def compare_instants(
        self,
        pairs: Sequence[tuple[int, int]],
        condition: Condition,
        offsets_ms: dict[str, float],
        *,
        folder: Path | None = None,
    ) -> StudyResult[None]:
        """Compare depth at pairs of instants; see `Score.compare_instants`."""
        reference, other = self.cameras
        self.progress.step(f"depth range of {reference} and {other}")
        options: Stereo = self.options
        method = msgspec.structs.replace(options, pair=self.pair, instants=tuple(now for now, _ in pairs))
        late = self.late_condition(condition, offsets_ms)

        def measure(one: StereoInstant) -> tuple[dict[str, Measurements], dict[str, float]]:
            facts: dict[str, float] = {"instant": one.now, "offset_instant": one.shown["offset"]}
            facts["mover_pixels"] = int(one.moving.sum())
            return {side: self._measure(one, side) for side in CONDITIONS}, facts

        scored = []
        both = (method.run(self.scene, at) for at in (SYNCHRONIZED, late))
        for synced, offset in zip(*both, strict=True):
            self.progress.step(f"stereo {reference}-{other}, instant {synced.instant}")
            scored.append({"synced": synced.checked, "offset": offset.checked})
        with worker_pool() as pool:
            instants = self._instants(pairs, scored, prepare_pair(self.scene, self.pair))
            tally = Tally(list(pool.map(measure, instants)))
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=offsets_ms,
            commands=self.commands(method, late),
            reason=self.reason,
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=self._pictures(instants, folder) if folder else (),
        )

    def _pictures(self, instants: Sequence[StereoInstant], out: Path) -> tuple[Picture, ...]:
        """Write pictures of the instant with the most moving pixels with depth."""
        first, second = self.pair
        one = max(instants, key=lambda i: int((i.moving & (i.maps["synced"].depth > 0)).sum()))
        photo = self.dataset.image(first, one.now)
        drawn = {
            side: _draw(one, side, photo, self.dataset.image(second, k)) for side, k in one.shown.items()
        }
        movers = (
            "Teal: both pictures agree on a distance. Orange: they do not."
            if one.truth is None
            else f"Teal: the distance found is right {TOLERANCE_TEXT}. Orange: there is none, or a wrong one."
        )
        return self.write_pictures(drawn, out, flat="stereo_depth", first=first, second=second, movers=movers)

    def _project_still(self, still: bytes) -> tuple[Array, Array]:
        """Return `project_into_other` of float32 depth; cached for conditions with the same instants."""
        reference, other = (self.scene.views[name] for name in self.cameras)
        depth = np.frombuffer(still, np.float32).reshape(reference.height, reference.width)
        return project_into_other(reference, other, depth)

    def _instants(
        self, pairs: Sequence[tuple[int, int]], maps: Sequence[dict[str, DepthMap]], matcher: StereoPair
    ) -> list[StereoInstant]:
        """Return the measured pixels of every instant, equal in both conditions."""
        (reference, other), dataset, motion = self.cameras, self.dataset, self.motion
        moving = [motion.moving(reference, now) for now, _ in pairs]
        still = median_still_depth([pair["synced"].depth for pair in maps], moving)
        where, inside = self._projected(still.tobytes())
        instants = []
        for (now, later), pair_maps, mask in zip(pairs, maps, moving, strict=True):
            static = still_pixels(
                where,
                inside,
                [motion.changing(reference, k) for k in {now, later} if dataset.has_image(reference, k)],
                [motion.changing(other, k) for k in {now, later}],
            )
            loaded = dataset.ground_truth(reference, now)
            truth = None if loaded is None else true_depth_in_unit(loaded[0], self.scene.unit, still, static)
            instants.append(
                StereoInstant(
                    now, {"synced": now, "offset": later}, pair_maps, mask & inside, static, truth, matcher
                )
            )
        return instants

    def _measure(self, one: StereoInstant, side: str) -> Measurements:
        reference, other = self.cameras
        side_maps = one.maps[side]
        images = self.dataset.grey(reference, one.now), self.dataset.grey(other, one.shown[side])
        measured = Measurements()
        masks = {"mover": one.moving, "static": one.static}
        errors = epipolar_errors(one.matcher, *images, tuple(masks.values()))
        for (kind, mask), off in zip(masks.items(), errors, strict=True):
            measured.update(measure_depth(side_maps.depth, side_maps.difference, mask, one.truth), f"{kind}_")
            measured.medians[f"{kind}_epipolar_px"] = np.array(off, float)
        return measured
