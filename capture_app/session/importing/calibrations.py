"""Calibrations of other programs, read by their importers and converted to this project's convention."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.text import Talk
from capture_app.session.format.calibration import (
    METRES,
    Calibration,
    CameraCalibration,
    Matrix3,
)
from capture_app.session.format.calibration_judge import check_lens, rig_faults
from capture_app.session.format.camera_labels import describe_pairs, pair_labels
from capture_app.session.format.export_record import ExportRecord
from capture_app.session.format.lens import Array, distortion_of, rotation_of, translation_of
from capture_app.session.importing.importer import load_importers, split_name
from capture_app.session.importing.recording_sources import Layout
from capture_app.session.importing.views import EXPORT_AGAIN, View, Views, read_json, root_of

Fit = Literal["exact", "crop", "scale"]
"""What to do if images do not have the size at which their camera was calibrated.

exact   refuse them, unless the aspect ratio is the same: then scale
crop    the images are the calibrated ones, cropped or extended at the right or the bottom
scale   they are the calibrated ones, scaled separately along each axis
"""
SAME_ASPECT = 1e-3
"""Relative difference of the scales along both axes from which images are stretched."""


def read_views(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views:
    """Read calibration files, each with its camera's name (or ''), for cameras in the rig's order.

    Give one file or folder with all cameras, or one for each camera, in a format that an importer reads.
    Raises BadInputError for anything else.
    """
    if missing := [path for _, path in paths if not path.exists()]:
        raise BadInputError(f"no calibration at {missing[0]}", hint="check the path after --calibration")
    first = paths[0][1]
    for importer in load_importers():
        if (views := importer.read_calibration(paths, cameras)) is not None:
            if len(paths) > 1 and not importer.calibration_per_camera:
                raise BadInputError(f"{first} holds all cameras", hint="give that one only")
            return views
    root = f" (its root is <{name}>)" if (name := root_of(first)) else ""
    if isinstance(content := None if first.is_dir() else read_json(first), dict):
        root = f" (its keys are {', '.join([*content][:8])})"
    raise BadInputError(
        f"{first} is not a calibration of a known format{root}",
        hint="capture-app sessions import --help lists the formats",
    )


def fit_calibration(
    views: Views,
    sizes: Mapping[str, tuple[int, int]],
    labels: Mapping[str, str] | None = None,
    *,
    unit: str | None = None,
    fit: Fit = "exact",
    talk: Talk = lambda said: None,
) -> Calibration:
    """Return the calibration of a recording's cameras, given their image sizes (width, height) in px.

    Lengths are converted to metres from the file's own unit, otherwise from `unit` (default m). An unknown
    unit, such as a board's square, is kept by name. `talk` receives which camera of the file is whose, unless
    the names are equal. `labels` is what their owner calls the cameras, by name. Raises BadInputError if a
    camera has no calibration, if its numbers are impossible for a camera, or if the size does not fit.
    """
    if unit is not None and views.unit is not None and unit != views.unit:
        raise BadInputError(f"{views.source} is in {views.unit}, not in {unit}", hint="leave out --unit")
    given = views.unit or unit or views.assumed_unit
    if views.unit is None and unit is None and given in METRES:
        talk(f"{views.source} states no unit of its lengths: {given} is assumed; --unit mm says otherwise")
    called = {name: (labels or {}).get(name, name) for name in sizes}
    pairs = pair_labels(views.cameras, called)
    if lacking := [called[name] for name in sizes if name not in pairs]:
        raise BadInputError(
            f"{views.source} calibrates {', '.join(views.cameras)}: "
            f"nothing for {', '.join(lacking)} of the recording",
            hint="name the cameras as in the calibration: NAME=PATH",
        )
    if said := describe_pairs(views.source, pairs, views.cameras, called):
        talk(said)
    cameras = {
        name: _camera(
            f"{views.source}: camera {name}",
            views.cameras[pairs[name]],
            size,
            METRES.get(given, 1.0),
            fit,
            talk,
        )
        for name, size in sizes.items()
    }
    given = "m" if given in METRES else given
    for name, why in rig_faults(cameras, given):
        if not name or len(cameras) <= 2:
            raise BadInputError(f"{views.source}: {why}", hint="state the unit of its lengths: --unit mm")
        talk(f"{name} is left out of the calibration: {why}")
        del cameras[name]
    return Calibration(cameras=cameras, unit=given, source=views.source, lenses=views.lenses)


def _camera(
    where: str,
    given: View | CameraCalibration,
    size: tuple[int, int],
    metres: float,
    fit: Fit,
    talk: Talk,
) -> CameraCalibration:
    if isinstance(given, View) and given.unrectified is not None and given.unrectified.size == size:
        given = given.unrectified
    camera, turned = (_of_view(where, given, size), given.turned) if isinstance(given, View) else (given, "")
    x, y = _factors(where, (camera.width, camera.height), turned, size, fit)
    if abs(x / y - 1) >= SAME_ASPECT:
        talk(
            f"{where} is taken for stretched images: {x:.3g} times as wide and {y:.3g} times as high as the "
            "calibrated ones; if they are cut off instead, give --fit crop"
        )
    camera = msgspec.structs.replace(
        camera,
        width=size[0],
        height=size[1],
        fx=camera.fx * x,
        fy=camera.fy * y,
        cx=(camera.cx + 0.5) * x - 0.5,
        cy=(camera.cy + 0.5) * y - 0.5,
        translation=(*(translation_of(camera) * metres).tolist(),),
    )
    check_lens(where, camera)
    left, _, right = np.linalg.svd(rotation_of(camera))
    return msgspec.structs.replace(
        camera, rotation=_rows(left @ right), distortion=(*distortion_of(camera).tolist(),)
    )


def _of_view(where: str, view: View, size: tuple[int, int]) -> CameraCalibration:
    """Return another program's camera as ours, of images of `size` if its file does not state theirs."""
    if not np.isfinite(view.matrix).all():
        raise BadInputError(f"{where} has numbers that are not finite", hint=EXPORT_AGAIN)
    (fx, skew, cx), (_, fy, cy), _ = view.matrix.tolist()
    if abs(skew) > 0.01:
        raise BadInputError(
            f"{where} has a skew of {skew:.3g} pixels; only a skew of 0 is supported",
            hint="calibrate with a skew of 0: reconstruct calibrate SESSION does",
        )
    if abs(view.matrix[2] - [0, 0, 1]).max() > 1e-6:
        raise BadInputError(f"{where} has no camera matrix: its last row is not 0, 0, 1", hint=EXPORT_AGAIN)
    (width, height), (x, y, z) = view.size or size, view.translation.ravel().tolist()
    return CameraCalibration(
        width=width,
        height=height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        rotation=_rows(view.rotation),
        translation=(x, y, z),
        distortion=(*view.distortion.ravel().tolist(),),
        model="fisheye" if view.is_fisheye else msgspec.UNSET,
    )


def _factors(
    where: str, calibrated: tuple[int, int], turned: str, size: tuple[int, int], fit: Fit
) -> tuple[float, float]:
    if calibrated == size:
        return 1.0, 1.0
    if min(calibrated) < 1:
        raise BadInputError(
            f"{where} is calibrated for {calibrated[0]}x{calibrated[1]} pixels", hint=EXPORT_AGAIN
        )
    x, y = size[0] / calibrated[0], size[1] / calibrated[1]
    if fit != "exact" or abs(x / y - 1) < SAME_ASPECT:
        return (1.0, 1.0) if fit == "crop" else (x, y)
    what = (
        f"{where} is calibrated for {calibrated[0]}x{calibrated[1]} pixels, its images are "
        f"{size[0]}x{size[1]}"
    )
    if calibrated == size[::-1]:
        raise BadInputError(
            f"{what}, turned by 90 degrees" + (f" (its {turned})" if turned else ""),
            hint="import the images as they were when the lens was calibrated, or calibrate these: "
            "import without --calibration, then reconstruct calibrate SESSION",
        )
    raise BadInputError(
        what,
        hint="--fit crop if their right or bottom is cut off, --fit scale if they are stretched",
    )


def _rows(matrix: Array) -> Matrix3:
    first, second, third = (tuple(row) for row in matrix.tolist())
    return first, second, third


def choose_calibration(
    layout: Layout,
    labels: Mapping[str, str],
    sizes: Callable[[], Mapping[str, tuple[int, int]]],
    given: Sequence[str] = (),
    unit: str | None = None,
    fit: Fit = "exact",
) -> tuple[Calibration | None, list[str]]:
    """Return the calibration for images of these sizes, and notes about it.

    It is the user's (`given`), otherwise the program's, the export's, or one beside that fits. `labels` is
    what their owner calls the cameras, by name. Raises BadInputError if it does not fit; one that is only
    beside it is then reported and not used.
    """
    notes: list[str] = []
    cameras = [*labels]
    own_unit, views = unit or layout.unit, layout.views
    if given:
        own_unit, views = unit, read_views([split_name(text) for text in given], cameras)
    elif layout.calibration is not None:
        views = read_views([("", layout.calibration)], cameras)
    if views is not None:
        return fit_calibration(views, sizes(), labels, unit=own_unit, fit=fit, talk=notes.append), notes
    if layout.record is not None or layout.beside is None:
        return _exported(layout.record, sizes()) if layout.record else None, notes
    try:
        views = read_views([("", layout.beside)], cameras)
        calibration = fit_calibration(views, sizes(), labels, unit=own_unit, fit=fit, talk=notes.append)
    except BadInputError as error:
        return None, [f"calibration: {layout.beside} is not taken: {error}"]
    return calibration, [f"calibration: {layout.beside}", *notes]


def _exported(record: ExportRecord, sizes: Mapping[str, tuple[int, int]]) -> Calibration | None:
    """Return the exported calibration. Raises BadInputError if the images now have a different size."""
    for name, camera in record.calibration.cameras.items() if record.calibration else ():
        if sizes.get(name, (camera.width, camera.height)) != (camera.width, camera.height):
            was, now = f"{camera.width}x{camera.height}", "x".join(map(str, sizes[name]))
            raise BadInputError(
                f"{name} was exported with {was} pixels and has {now} now",
                hint="give one that fits: --calibration PATH",
            )
    return record.calibration
