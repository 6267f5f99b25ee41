"""Refinement of a calibration's poses by points at rest; the rig's place and scale are kept."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import structs

from capture_app.common.errors import NotApplicableError
from reconstruction.common.colmap import build_model, load_pycolmap
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import foreign_calls
from reconstruction.scene.calibration.consistency import (
    Track,
    check_rig,
    find_tracks,
    reprojection_errors,
    triangulate,
)
from reconstruction.scene.pairs import Features
from reconstruction.scene.scene import Scene

MAX_OFF_PX = 12.0
"""Reprojection error beyond which a track is a wrong match, or the calibration another rig's."""
MIN_POINTS_PER_CAMERA = 30
"""Minimum number of points at rest that a camera must see."""


def refine_calibration(scene: Scene) -> Scene:
    """Return the scene with its calibration's poses refined by points at rest in its middle images.

    Lenses stay as they are. How uncertain the scale is, becomes its `scale_error`. If the points do not fit
    better afterwards, the scene is returned as it is.

    Raises:
        NotApplicableError: there is no calibration, or it has too few points at rest to be refined by.
        NotAvailableError: pycolmap is not installed.
    """
    if (calibration := scene.given) is None:
        raise NotApplicableError(
            f"{scene.dataset.name} has no calibration to refine",
            hint="leave out --refine: images give one",
        )
    features = scene.features.middle
    refined = refine_views(scene.views, features)
    before, after = (check_rig(views, features).error_px for views in (scene.views, refined))
    if before is None or after is None or after >= before:
        return scene
    cameras = {name: view.to_calibration() for name, view in refined.items()}
    source = f"{calibration.source_words}, refined from {before:.2f} to {after:.2f} px by points at rest"
    better = structs.replace(calibration, cameras=calibration.cameras | cameras, source=source)
    return scene.calibrated(better, estimate_scale_error(scene.views, refined))


def refine_views(views: Mapping[str, View], features: Mapping[str, Features]) -> dict[str, View]:
    """Return views with poses that fit static features best; the mean pose and the scale stay the same.

    By COLMAP's bundle adjustment, with lenses held. The scale is the distances between the cameras.

    Raises NotApplicableError where a camera shares too few points.
    """
    pycolmap = load_pycolmap("refining a calibration")
    tracks = [track for track in find_tracks(views, features) if _is_plausible(views, track)]
    counts = {name: sum(name in track for track in tracks) for name in views}
    if poor := [name for name, number in counts.items() if number < MIN_POINTS_PER_CAMERA]:
        raise NotApplicableError(
            f"{poor[0]} shares only {counts[poor[0]]} points at rest with other cameras; "
            f"{MIN_POINTS_PER_CAMERA} are needed to refine its pose",
            hint="leave out --refine, or calibrate with a board",
        )
    with foreign_calls("pycolmap", "refining a calibration"):
        model, numbers = _model(pycolmap, views, tracks), range(1, 1 + len(views))
        config = pycolmap.BundleAdjustmentConfig()
        for number in numbers:
            config.add_image(number)
            config.set_constant_cam_intrinsics(number)
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        options = pycolmap.BundleAdjustmentOptions(print_summary=False)
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = 0.5
        pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
        poses = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
    refined = {
        name: replace(view, rotation=poses[name][:, :3], translation=poses[name][:, 3])
        for name, view in views.items()
    }
    return _in_place(refined, views)


def _is_plausible(views: Mapping[str, View], track: Track) -> bool:
    point = _point(views, track)
    return bool(np.isfinite(point).all()) and all(
        reprojection_errors(views[name], point[None], at[None])[0] < MAX_OFF_PX for name, at in track.items()
    )


def _point(views: Mapping[str, View], track: Track) -> Array:
    points = triangulate([views[name] for name in track], np.array([[at] for at in track.values()]))
    return np.asarray(points[0])


def _model(pycolmap: Any, views: Mapping[str, View], tracks: list[Track]) -> Any:
    """Return COLMAP's model of undistorted cameras and points."""
    pixels: dict[str, list[Array]] = {name: [] for name in views}
    numbers, points = {name: number for number, name in enumerate(views, 1)}, []
    for track in tracks:
        points.append((_point(views, track), {numbers[name]: len(pixels[name]) for name in track}))
        for name, at in track.items():
            pixels[name].append(at)
    keypoints = {name: view.undistort(np.array(pixels[name])) for name, view in views.items()}
    return build_model(pycolmap, views, keypoints, points)


def _in_place(views: Mapping[str, View], before: Mapping[str, View]) -> dict[str, View]:
    """Return the views turned, moved and scaled as a whole to where they were before."""
    centres, old = (np.array([poses[name].centre for name in views]) for poses in (views, before))
    middle, old_middle = centres.mean(0), old.mean(0)
    size, old_size = float(np.linalg.norm(centres - middle)), float(np.linalg.norm(old - old_middle))
    scale = old_size / size if size else 1.0
    # The mean rotation in the chordal sense (Hartley et al. 2013).
    left, _, right = np.linalg.svd(
        sum(before[name].rotation.T @ view.rotation for name, view in views.items())
    )
    aligned = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    placed = {}
    for name, view in views.items():
        rotation = view.rotation @ aligned.T
        centre = old_middle + scale * aligned @ (view.centre - middle)
        placed[name] = replace(view, rotation=rotation, translation=-rotation @ centre)
    return placed


def estimate_scale_error(before: Mapping[str, View], refined: Mapping[str, View]) -> float:
    """Return the standard deviation of the scale of refined views, relative to the scale.

    Images show the rig's shape but not its scale, which is that of the cameras' distances before. As far as
    the cameras stood beside that shape, so far is the scale probably off, divided by the rig's size.
    """
    centres, old = (np.array([poses[name].centre for name in before]) for poses in (refined, before))
    # A shift and a scale were fitted to the places: 4. Student's variance is that of 2 fewer.
    sigma = np.linalg.norm(old - centres) / np.sqrt(max(centres.size - 6, 1))
    return float(sigma / np.linalg.norm(centres - centres.mean(0)))
