"""Calibration of a rig by COLMAP's structure from motion, from the static part of a burst."""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import talk
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.lens import lens_of
from capture_app.session.reading.decoding import read_exif
from reconstruction.common.colmap import load_pycolmap
from reconstruction.common.geometry import View
from reconstruction.common.image_files import FAST_PNG, write_image
from reconstruction.common.memory import memory_budget
from reconstruction.common.native_libraries import ForeignError
from reconstruction.scene.calibration.consistency import (
    GIVEN_ERROR,
    MAX_BELIEVED,
    fit_one_plane,
    lens_knowledge,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion

MAX_FOCAL_RATIO = 1.25
"""Maximum ratio of a found to the likely focal length; equivalent ones are rounded to whole millimetres."""
MAX_PERSPECTIVE_DEG = 175.0
"""Maximum field of view of a perspective lens."""
WIDEST_DEG = 100.0
"""Field of view from which a found lens is unlikely."""
MIN_TO_SEPARATE_LENSES = 3
"""Minimum cameras that determine focal lengths; with two whose axes meet, any focal length fits."""
GIVE_CALIBRATION = "give it a calibration: reconstruct calibrate SESSION --from PATH, or --from board"
GIVE_LENSES = "or give the cameras' horizontal view: reconstruct calibrate SESSION --field-of-view DEG"
"""Hint where no lens was known."""


def likely_focal_lengths(
    dataset: Dataset, field_of_view_deg: float | None = None, *, fisheyes: bool = False
) -> dict[str, float]:
    """Return likely focal lengths, px, by camera: from the horizontal field of view, else from EXIF.

    Raises BadInputError for fisheyes without a field of view, as EXIF does not state theirs, and for a field
    that no perspective lens has.
    """
    if field_of_view_deg is not None and not fisheyes and field_of_view_deg > MAX_PERSPECTIVE_DEG:
        raise BadInputError(
            f"no perspective lens sees {field_of_view_deg:g} degrees", hint="for fisheyes: --lens fisheye"
        )
    if field_of_view_deg is not None:
        angle = math.radians(field_of_view_deg)
        across = angle if fisheyes else 2 * math.tan(angle / 2)
        return {name: dataset.size(name)[0] / across for name in dataset.cameras}
    if fisheyes:
        raise BadInputError(
            "fisheyes are found from images only with their field of view",
            hint="give the horizontal one of the data sheet: --field-of-view 130",
        )
    # Equivalent focal lengths refer to the 36 x 24 mm format (CIPA DC-008).
    return {
        name: mm / 43.27 * math.hypot(*dataset.size(name))
        for name in dataset.cameras
        if (mm := _exif_focal_35mm(dataset, name)) is not None
    }


def _exif_focal_35mm(dataset: Dataset, camera: str) -> int | None:
    with suppress(OSError, ValueError):
        for instant in dataset.instants(camera)[:1]:
            return read_exif(dataset.image_bytes(camera, instant)).focal_35mm
    return None


def refuse_odd_lenses(found: Mapping[str, CameraCalibration], focal_px: Mapping[str, float]) -> None:
    """Refuse focal lengths that structure from motion cannot have determined.

    A static scene with little depth leaves a focal length nearly free, however well the points fit.

    Raises:
        NotApplicableError: a focal length is far from the likely one, or wider than plain lenses are.
    """
    for name, camera in found.items():
        view_deg = lens_of(camera).field_deg(camera.width)
        if (likely := focal_px.get(name)) is None:
            odd, why, exif = view_deg > WIDEST_DEG, "which is unlikely", ""
        else:
            odd = not 1 / MAX_FOCAL_RATIO < plain_focal_px(camera) / likely < MAX_FOCAL_RATIO
            why = f"not {field_of_view_deg(camera, likely):.0f} as it likely does"
            exif = "" if camera.is_fisheye else "correct the pictures' EXIF, "
        if odd:
            raise NotApplicableError(
                f"{name} would see {view_deg:.0f} degrees wide, {why}: "
                "the static scene has too little depth to determine its lens",
                hint=f"calibrate with a board, {exif}{GIVE_LENSES}",
            )


def field_of_view_deg(camera: CameraCalibration, focal_px: float) -> float:
    """Return the horizontal field of view of a camera of this model and focal length, without distortion."""
    return math.degrees(
        camera.width / focal_px if camera.is_fisheye else 2 * math.atan(camera.width / 2 / focal_px)
    )


def plain_focal_px(camera: CameraCalibration) -> float:
    """Return the focal length of a lens without distortion that has this one's horizontal field of view."""
    half = math.radians(lens_of(camera).field_deg(camera.width)) / 2
    return camera.width / 2 / (half if camera.is_fisheye else math.tan(half))


def guess_calibration(motion: SceneMotion) -> Calibration:
    """Calibrate a session that has no calibration from its images, and say so.

    Raises as `calibrate_from_images`.
    """
    calibration = calibrate_from_images(motion)
    talk(f"{motion.dataset.name} has no calibration; this one was found: {calibration.source}")
    return calibration


def calibrate_from_images(
    motion: SceneMotion, field_of_view_deg: float | None = None, *, fisheyes: bool = False
) -> Calibration:
    """Calibrate the rig with COLMAP from the static content of a burst; the unit of length is arbitrary.

    Each camera has one picture, its background: the median over time has no moving objects and little noise,
    and further instants would show the same static points again. The horizontal field of view gives the
    lenses' initial values; None = from EXIF, if any. `fisheyes`: all lenses are, instead of perspective ones.

    Raises:
        NotAvailableError: COLMAP is not installed here.
        BadInputError: it found no cameras, or implausible lenses.
    """
    pycolmap = load_pycolmap("finding the cameras' positions from the images", hint=GIVE_CALIBRATION)
    dataset = motion.dataset
    cameras = [name for name in dataset.cameras if dataset.instants(name)]
    if len(cameras) < 2:
        raise NotApplicableError(
            "no calibration in the session, and fewer than two cameras with an image to find it from",
            hint=GIVE_CALIBRATION,
        )
    focal_px = likely_focal_lengths(dataset, field_of_view_deg, fisheyes=fisheyes)
    model = "RADIAL_FISHEYE" if fisheyes else "SIMPLE_RADIAL"
    if len(focal_px) < len(cameras) < MIN_TO_SEPARATE_LENSES:
        raise NotApplicableError(
            "no calibration in the session, and two cameras' images do not determine their lenses",
            hint=f"{GIVE_CALIBRATION}, {GIVE_LENSES}",
        )
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        root = Path(scratch)
        for name in cameras:
            (root / "images" / name).mkdir(parents=True)
            write_image(root / "images" / name / "background.png", motion.background(name), FAST_PNG)
        if len(cameras) >= MIN_TO_SEPARATE_LENSES:
            found = _found(pycolmap, dataset, cameras, root, focal_px, model, held=False)
            try:
                refuse_odd_lenses(found[0].cameras, focal_px)
            except NotApplicableError:
                if len(focal_px) < len(cameras):
                    raise
                with suppress(NotApplicableError):
                    # Without what was given: a wrong lens to begin with leads to wrong poses.
                    alone = _found(pycolmap, dataset, cameras, root, {}, model, held=False)
                    if max(alone[1], default=math.inf) <= MAX_BELIEVED:
                        return _contradicting(alone, focal_px)
            else:
                return _contradicting(found, focal_px)
        # The static scene does not determine the lenses: fix them at their likely values.
        return _found(pycolmap, dataset, cameras, root, focal_px, model, held=True)[0]


_Found = tuple[Calibration, Sequence[float]]
"""A calibration by COLMAP, and the relative 95 % errors of its focal lengths; none if not determined."""


def _contradicting(solved: _Found, focal_px: Mapping[str, float]) -> Calibration:
    """Return a calibration, with the given fields of view that it contradicts in its source, and say so."""
    calibration, errors = solved
    worst, cameras = max(errors, default=math.inf), calibration.cameras
    if not (given := focal_px.keys() & cameras.keys()) or worst > MAX_BELIEVED:
        return calibration
    found = {name: plain_focal_px(cameras[name]) for name in sorted(given)}
    name = max(found, key=lambda one: abs(math.log(found[one] / focal_px[one])))
    if abs(math.log(found[name] / focal_px[name])) <= worst + GIVEN_ERROR:
        return calibration
    degrees, wrong, low = (
        field_of_view_deg(cameras[name], of)
        for of in (found[name], focal_px[name], found[name] * (1 + worst))
    )
    text = f"{wrong:.1f} degrees were given; the pictures say {degrees:.1f} ± {degrees - low:.1f} ({name})"
    talk(f"{text}: the pictures are believed")
    return msgspec.structs.replace(calibration, source=f"{calibration.source}, {text}")


def _found(
    pycolmap: Any,
    dataset: Dataset,
    cameras: Sequence[str],
    root: Path,
    focal_px: Mapping[str, float],
    model: str,
    *,
    held: bool,
) -> _Found:
    extraction = _extraction(pycolmap, [dataset.size(name) for name in cameras])
    # By the exact focal length, both poses that a plane allows fit a pair equally.
    for start in (1.0, 1 - GIVEN_ERROR, 1 + GIVEN_ERROR)[: None if focal_px and not held else 1]:
        with tempfile.TemporaryDirectory(dir=root) as work:
            lenses_px = {name: focal * start for name, focal in focal_px.items()}
            rec = _solve(pycolmap, Path(work), lenses_px, extraction, model, held=held)
        if rec is not None:
            break
    advice = f", {GIVE_LENSES}" if len(focal_px) < len(cameras) else ""
    if rec is None:
        raise NotApplicableError(
            "no calibration in the session, and none can be found from its images",
            hint=f"the views need to overlap and show something with texture; {GIVE_CALIBRATION}{advice}",
        )
    if len(found := _cameras(rec, dataset)) < 2:
        raise NotApplicableError(
            "only one camera could be placed", hint=f"the views need to overlap more{advice}"
        )
    if held:
        errors, why = list[float](), "these pictures do not confirm the field of view that was given"
    elif lie_flat(rec):
        errors, why = [], "these points lie in one plane, or far away"
    else:
        errors, why = focal_errors(pycolmap, rec), "too few points"
    lenses = lens_knowledge(errors, why, is_guess=bool(advice))
    missing = ", ".join(name for name in dataset.cameras if name not in found)
    left_out = f"; not placed: {missing}" if missing else ""
    return Calibration(
        cameras=found,
        unit="arbitrary",
        source=f"COLMAP {pycolmap.__version__}, {len(found)} of {len(dataset.cameras)} cameras from "
        f"{rec.num_points3D()} still points, {rec.compute_mean_reprojection_error():.2f} px"
        f", {lenses.text}{left_out}",
        lenses=lenses,
    ), errors


def _placed(rec: Any) -> list[Any]:
    """Return the images of a model that have a pose, one of each camera."""
    return [image for image in rec.images.values() if image.has_pose]


def lie_flat(rec: Any) -> bool:
    """Return whether what any two cameras of a model see determines no geometry; see `fit_one_plane`.

    By rays, as pixels of a straight lens: what lies in a plane bends in a fisheye's image.
    """
    seen = []
    for image in _placed(rec):
        points = [point for point in image.points2D if point.has_point3D()]
        rays = image.camera.cam_from_img(np.array([point.xy for point in points]).reshape(-1, 2))
        # Beyond 60 degrees, rays enlarge a pixel's noise.
        near = (rays**2).sum(1) < 3.0
        straight = rays * image.camera.params[0]
        seen.append(
            {p.point3D_id: at for p, at, is_near in zip(points, straight, near, strict=True) if is_near}
        )
    both = ((first, other, [*first.keys() & other.keys()]) for first, other in combinations(seen, 2))
    return all(fit_one_plane(*(np.array([of[key] for key in keys]) for of in pair)) for *pair, keys in both)


def focal_errors(pycolmap: Any, rec: Any) -> list[float]:
    """Return the relative 95 % errors of a model's focal lengths; none if they are free or for two cameras.

    From the covariance of a bundle adjustment, which refines the model, and from adjustments that begin at
    other focal lengths: a scene with little depth has several that fit as well, each with a small covariance.
    Principal points count as known, and lenses as having one distortion term.
    """
    shown = _placed(rec)
    if len(shown) < MIN_TO_SEPARATE_LENSES:
        return []
    config = pycolmap.BundleAdjustmentConfig()
    for image in shown:
        config.add_image(image.image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.THREE_POINTS)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(
        pycolmap.BundleAdjustmentOptions(print_summary=False), config, rec
    )
    solved = adjuster.solve().ceres_summary
    covariance = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), rec, adjuster)
    spare = solved.num_residuals - solved.num_effective_parameters
    lenses = [image.camera.params for image in shown]
    covariances = [] if covariance is None else [covariance.get_other_params_cov(lens) for lens in lenses]
    if spare < 1 or not covariances or any(places is None for places in covariances):
        return []
    others = [*_detours(pycolmap, rec)]
    return [
        2 * math.sqrt(2 * solved.final_cost / spare * places[0, 0]) / float(image.camera.focal_length)
        + max(
            (abs(math.log(other[image.camera_id] / image.camera.focal_length)) for other in others), default=0
        )
        for places, image in zip(covariances, shown, strict=True)
    ]


def _detours(pycolmap: Any, rec: Any) -> Iterator[dict[int, float]]:
    """Yield focal lengths, by camera, that fit a model's points as well as its own."""
    rec.update_point_3d_errors()
    own_px = rec.compute_mean_reprojection_error()
    # These are sought again from other ones, without distortion at first.
    for factor in (0.5, 1.4):
        other = deepcopy(rec)
        for camera in other.cameras.values():
            focal, *centre = camera.params[:3]
            camera.params = [factor * focal, *centre] + [0.0] * (len(camera.params) - 3)
        with suppress(ForeignError):
            for free in (False, True):
                options = pycolmap.BundleAdjustmentOptions(print_summary=False)
                options.refine_focal_length = options.refine_extra_params = free
                pycolmap.bundle_adjustment(other, options)
            other.update_point_3d_errors()
            # Points behind their cameras have no error, or an infinite one.
            if own_px / 1.1 < other.compute_mean_reprojection_error() < own_px * 1.1:
                yield {number: camera.focal_length for number, camera in other.cameras.items()}


def _extraction(pycolmap: Any, sizes: Sequence[tuple[int, int]]) -> Any:
    """Return COLMAP's options for feature extraction: the image size within the memory budget, one thread."""
    options = pycolmap.FeatureExtractionOptions()
    limit = int(options.eff_max_image_size())

    def bytes_at(scale: float) -> float:
        shrunk = (min(1.0, limit / max(size)) * scale for size in sizes)
        # SIFT holds the image at twice its size, a dozen times in float, and its smaller octaves.
        return 220.0 * max(w * h * s**2 for (w, h), s in zip(sizes, shrunk, strict=True))

    scale = memory_budget().fit_scale("the features of a picture", bytes_at, fraction=0.6)
    options.max_image_size = max(1, int(min(limit, max(map(max, sizes))) * scale)) if scale < 1 else limit
    # With several threads, the images' order in the database, and so the result, changes from run to run.
    options.num_threads = 1
    # Below COLMAP's 0.0067: a median over time has little noise.
    options.sift.peak_threshold = 0.004
    return options


def _solve(
    pycolmap: Any,
    work: Path,
    focal_px: Mapping[str, float],
    extraction: Any,
    model: str,
    *,
    held: bool,
) -> Any | None:
    """Return the largest model; `work` is a new folder inside the root. `held`: focal lengths are fixed."""
    root, database = work.parent, work / "database.db"
    pycolmap.set_random_seed(0)
    pycolmap.extract_features(
        database,
        root / "images",
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
        reader_options=pycolmap.ImageReaderOptions(camera_model=model),
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    _set_focal_lengths(pycolmap, database, focal_px)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    pycolmap.match_exhaustive(database, verification_options=verification, device=pycolmap.Device.cpu)
    (work / "global").mkdir()
    (work / "incremental").mkdir()
    best = None
    with suppress(ForeignError):
        if not held:
            pycolmap.calibrate_view_graph(database)
        mapping = pycolmap.GlobalPipelineOptions(random_seed=0, num_threads=1, min_model_size=2)
        mapping.mapper.bundle_adjustment.refine_focal_length = not held
        best = _largest(pycolmap.global_mapping(database, root / "images", work / "global", mapping))
    if best is None or best.num_reg_images() < 2:
        # Global mapping can fail on scenes with little depth; incremental mapping is more robust.
        options = pycolmap.IncrementalPipelineOptions(
            random_seed=0,
            num_threads=1,
            multiple_models=False,
            min_model_size=2,
            ba_refine_focal_length=not held,
            triangulation={"ignore_two_view_tracks": False},
        )
        # Neighbours in a row are below COLMAP's 16 degrees.
        options.mapper.init_min_tri_angle = 4.0
        with suppress(ForeignError):
            best = _largest(
                pycolmap.incremental_mapping(database, root / "images", work / "incremental", options)
            )
    return best


def _set_focal_lengths(pycolmap: Any, database: Path, focal_px: Mapping[str, float]) -> None:
    opened = pycolmap.Database.open(database)
    lenses = {camera.camera_id: camera for camera in opened.read_all_cameras()}
    for image in opened.read_all_images():
        if (focal := focal_px.get(image.name.split("/")[0])) is not None:
            lens = lenses[image.camera_id]
            lens.focal_length = focal
            lens.has_prior_focal_length = True
            opened.update_camera(lens)
    opened.close()


def _largest(models: dict[int, Any]) -> Any | None:
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _cameras(rec: Any, dataset: Dataset) -> dict[str, CameraCalibration]:
    """Return the calibration of each camera with a pose."""
    placed = {image.name.split("/")[0]: image for image in _placed(rec)}
    return {
        name: _calibration(placed[name], dataset.size(name)) for name in dataset.cameras if name in placed
    }


def _calibration(image: Any, size: tuple[int, int]) -> CameraCalibration:
    matrix = np.asarray(image.cam_from_world().matrix())
    focal, cx, cy, *radial = (float(value) for value in image.camera.params)
    # COLMAP's first pixel has its centre at (0.5, 0.5).
    intrinsics = np.array([[focal, 0, cx - 0.5], [0, focal, cy - 0.5], [0, 0, 1]])
    fisheye = image.camera.model.name.endswith("FISHEYE")
    distortion = np.array([*radial, 0, 0] if fisheye else [*radial, 0, 0, 0, 0])
    return View(*size, intrinsics, distortion, matrix[:, :3], matrix[:, 3], fisheye).to_calibration()
