"""Moments of a session with depth, computed by the installed method for depth from all cameras."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from capture_app.common.errors import IncompleteError
from capture_app.console.terminal import Progress
from capture_app.session.exporting.exported_burst import mask_path
from capture_app.session.format.calibration import Calibration
from reconstruction.calibration.calibrated_rig import calibrated_views
from reconstruction.compare.method import find_method
from reconstruction.depth.seen_moment import Moment, read_moment
from reconstruction.session.conditions import SYNCHRONIZED, Condition
from reconstruction.session.dataset import Dataset

DEPTH = "multiview"
"""Name of the method that computes depth maps."""


class SeenInstant(NamedTuple):
    """One instant as its cameras saw it, and why other cameras are left out."""

    instant: int
    moment: Moment
    left_out: Mapping[str, str]


def require_calibration(dataset: Dataset) -> Calibration:
    """Return the session's calibration; raise IncompleteError if it has none."""
    if (calibration := dataset.calibration()) is None:
        raise IncompleteError(
            f"{dataset.name} has no calibration, which a view from elsewhere needs",
            hint=f"reconstruct calibrate {dataset.session.folder}",
        )
    return calibration


def see_moments(
    dataset: Dataset,
    instants: Sequence[int],
    condition: Condition = SYNCHRONIZED,
    *,
    without: Sequence[str] = (),
    quick: bool = False,
    progress: Progress | None = None,
) -> Iterator[SeenInstant]:
    """Yield each instant with depth of all cameras that have it, under a condition.

    Several instants share what stands still. One instant can be seen `without` some cameras. Raises as the
    method does, and IncompleteError without a calibration.
    """
    views = calibrated_views(dataset, require_calibration(dataset))
    common: dict[str, Any] = {"quick": quick, "calibrated": True, "time_shifts_ms": dataset.time_shifts_ms}
    if progress is not None:
        common["progress"] = progress
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        folder = Path(scratch, "maps")
        if len(instants) == 1:
            lean: dict[str, Any] = {"mesh": False, "cloud": False, "workspace": False}
            method = find_method(DEPTH, instant=instants[0], without=tuple(without), **lean, **common)
            result = method.make([dataset.session.folder], folder, condition)
            images = {one.camera: dataset.image(one.camera, one.instant) for one in result.views}
            files = {camera: folder / "depth" / f"{camera}.npz" for camera in images}
            yield SeenInstant(instants[0], read_moment(files, views, images), result.left_out)
            return
        common |= {"instants": tuple(instants), "mesh": False, "depth": True, "workspace": False}
        result = find_method(DEPTH, **common).make([dataset.session.folder], folder, condition)
        for one in result.instants:
            shown = dataset.nearest_instants(one.instant, condition.offsets_ms(dataset.cameras, one.instant))
            files = {
                camera: file
                for camera in views
                if (file := mask_path(folder / "depth", camera, one.instant).with_suffix(".npz")).is_file()
            }
            if files:
                images = {camera: dataset.image(camera, shown[camera]) for camera in files}
                yield SeenInstant(one.instant, read_moment(files, views, images), one.left_out)
