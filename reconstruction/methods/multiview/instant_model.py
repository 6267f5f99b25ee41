"""Depth of every camera at an instant, a fused point cloud, a mesh, and a page."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import NotApplicableError, NotAvailableError
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.files.output_folder import OutputFolder
from capture_app.session.files.untrusted_files import read_arrays
from capture_app.session.reading.take_sheet import PAIR_DEPTH
from reconstruction.common.drawing import colour_confidence, colour_depth, display_range
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import write_image
from reconstruction.common.outputs import Made
from reconstruction.common.wording import percentage
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.geometric_consistency import MAX_COST
from reconstruction.depth.plane_sweep import PlaneSweep
from reconstruction.method.truth import DepthShares, depth_shares
from reconstruction.methods.multiview.confidence import measure_support
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.input_images import (
    InputImage,
    InputImages,
    check_images,
    undistorted_truth,
)
from reconstruction.methods.multiview.instant_maps import match_instant
from reconstruction.methods.multiview.instant_scoring import score_moving
from reconstruction.methods.multiview.matcher import image_colours, image_views
from reconstruction.methods.multiview.mesh import build_mesh
from reconstruction.methods.multiview.multiview_options import MultiviewOptions
from reconstruction.methods.multiview.result import (
    CONFIDENCE,
    FILES,
    FUSED,
    POINTS,
    RESULT,
    WORKSPACE,
    MultiviewResult,
    ViewResult,
)
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.pages.embedding import InstantClouds, embed_image, view_clouds
from reconstruction.pages.page import Section, render_page, write_page
from reconstruction.scene.calibration.consistency import CalibrationCheck, turn_error
from reconstruction.scene.conditions import Condition
from reconstruction.scene.scene import Scene

FIGURES = ("coverage", "expected_within_2pct", "expected_range", *DepthShares.__struct_fields__)
"""Results of the reference view that represent its instant."""
Confidence = tuple[Array, tuple[float, float]]
"""Probability of each pixel's depth to be right, 0 without one, and the 95 % interval of its mean."""


class MadeMultiview(Made[MultiviewResult]):
    """Depth of all cameras at one instant, in the result's `unit`, and a point cloud in the rig's frame."""

    def depth(self, camera: str) -> Array:
        """Return depth along the axis on undistorted pixels, float32 height x width, 0 = unknown."""
        return self._view(camera)["depth"]

    def normals(self, camera: str) -> Array:
        """Return surface normals in the camera's frame, float16 height x width x 3."""
        return self._view(camera)["normals"]

    def confidence(self, camera: str) -> Array:
        """Return the probability that depth is within 2 % of the true one, float32; 0 where it is unknown.

        Raises:
            NotAvailableError: COLMAP matched, whose maps have none, or the lenses are not known to 2 %.
        """
        if (confidence := self._view(camera).get(CONFIDENCE)) is None:
            raise NotAvailableError(
                f"the depth of {camera} has no confidence: "
                "COLMAP's PatchMatch does not report any, and lenses that are not known to 2 % allow none",
                hint="compute it with --matcher sweep, by a calibration from a board",
            )
        return confidence.astype(np.float32)

    @property
    def cloud(self) -> PointCloud:
        """Fused cloud: `points` (n, 3), `colours` (n, 3), uint8 RGB. Raises IncompleteError if missing."""
        return read_ply(self.folder / FUSED)

    def _view(self, camera: str) -> dict[str, Array]:
        return read_arrays(self.folder / "depth" / f"{camera}.npz")


def model_instant(
    inputs: InputImages,
    condition: Condition,
    instant: int,
    options: MultiviewOptions,
    part: Path,
    *,
    still: StillScene | None = None,
    early: OutputFolder | None = None,
) -> MultiviewResult:
    """Compute an instant's depth maps, cloud and mesh in `part`, an existing empty folder.

    Without the check of the calibration, maps have no confidence. `still` is the still scene found at earlier
    instants. `early`: the output folder of `part`, which shows two cameras' depth (`PAIR_DEPTH`) until all is
    done, and then a page.

    Raises:
        BadInputError: the instant or the condition cannot be used, or nothing was found.
    """
    scene, dataset, progress = inputs.scene, inputs.dataset, options.progress
    progress.later = 2 if options.cleans_cloud else 1
    maps_found = match_instant(
        inputs,
        instant,
        condition,
        options,
        still or StillScene(),
        progress,
        workspace=part / WORKSPACE if options.workspace else None,
        on_pair=partial(_show_pair, early) if early is not None else None,
    )
    images, sources, rough, maps = maps_found.images, maps_found.sources, maps_found.rough, maps_found.maps
    checked, confidence = None, dict[str, Confidence]()
    if options.check:
        checked = check_images(maps_found.usable)
        if not scene.lenses.doubt(rough=True):
            confidence = measure_confidence(images, sources, maps, checked, scene.scale_error)
    residual_px = None if checked is None else checked.error_px
    views, pictures = image_views(images), image_colours(images)
    progress.step("fusing the maps into a cloud")
    fused = maps_found.cloud
    if not len(fused.points):
        raise NotApplicableError(
            "no point of the scene is consistent in enough cameras",
            hint="cameras must see the same things, at the same time, from different places, "
            "and their calibration must be this rig's",
        )
    write_ply(part / FUSED, PointCloud(fused.points, fused.colours), fused.normals)
    scored = tuple(
        write_view(scene, images[c], one, confidence.get(c), sources[c], part) for c, one in maps.items()
    )
    # Open3D searches the cloud's neighbours, and takes longer to load than all the rest.
    moving_score = None if options.quick else score_moving(dataset, images, scene.unit, instant, fused)
    points, triangles = len(fused.points), 0
    files: tuple[str, ...] = ()
    if options.cleans_cloud:
        progress.step("cloud, mesh and pictures" if options.makes_mesh else "cleaning the cloud")
        points, triangles, files = build_mesh(
            fused, part, views, maps, pictures, unit=scene.unit, mesh=options.makes_mesh
        )
    reference = maps_found.reference
    image, depth = images[reference], maps[reference].depth
    own = next(view for view in scored if view.camera == reference)
    others = [view for name, view in views.items() if name != reference]
    ranges = [rough.depth_ranges[camera] for camera in images]
    result = MultiviewResult(
        session=dataset.name,
        instant=instant,
        offsets_ms=condition.offsets_ms(dataset.cameras, instant),
        matcher=options.chosen_matcher.name,
        matcher_note=options.chosen_matcher.note,
        calibration=scene.source,
        lenses=scene.lenses,
        unit=scene.unit,
        reference=reference,
        **{name: getattr(own, name) for name in FIGURES},
        rest_error_px=None if residual_px is None else round(residual_px, 3),
        rest_errors_px={} if checked is None else {c: round(px, 3) for c, px in checked.errors_px.items()},
        rest_points=0 if checked is None else checked.points,
        turn_error=turn_error(views[reference], others[0], depth) if len(others) == 1 else None,
        scale_error=round(scene.scale_error, 4),
        movers_1cm=moving_score,
        moving_measured=measured_fraction(image, depth) if early is not None else None,
        nearest=min(nearest for nearest, _ in ranges),
        farthest=max(farthest for _, farthest in ranges),
        views=scored,
        left_out=dict(maps_found.left_out),
        fused_points=len(fused.points),
        cloud_points=points,
        mesh_triangles=triangles,
        files=(
            FUSED,
            *files,
            *(FILES if early is not None else ()),
            *((WORKSPACE,) if options.workspace else ()),
            RESULT,
        ),
    )
    if early is not None:
        write_moment(result, image, depth, fused, part)
    return result


def _show_pair(
    early: OutputFolder, first: CalibratedImage, second: CalibratedImage, depth_range: tuple[float, float]
) -> None:
    """Draw two cameras' depth at a small size as `PAIR_DEPTH`, and show it in the target."""
    reference, other = (image.scaled(320 / image.view.width) for image in (first, second))
    surface = PlaneSweep().sweep(reference, [other], depth_range)
    depth = surface.depth_where(surface.cost < MAX_COST)
    drawn = early.folder / PAIR_DEPTH
    write_image(drawn, colour_depth(depth, *display_range(depth)))
    early.show_early(PAIR_DEPTH)
    drawn.unlink()


def measure_confidence(
    images: Mapping[str, InputImage],
    sources: Mapping[str, Sequence[str]],
    maps: Mapping[str, ViewDepth],
    checked: CalibrationCheck,
    scale_error: float,
) -> dict[str, Confidence]:
    """Return by camera the probability that depth is right, 0 where it is unknown; not of COLMAP's maps.

    The second of each is the 95 % interval of its mean.

    `checked` has the misfits of points at rest to the calibration; `scale_error` is the relative standard
    deviation of its scale.
    """
    calibrated = {camera: image.calibrated for camera, image in images.items()}
    result = dict[str, Confidence]()
    for camera, support in measure_support(calibrated, sources, maps):
        known, residual_px = maps[camera].depth > 0, checked.errors_px.get(camera, checked.error_px)
        sure = np.where(known, support.confidence(residual_px, scale_error), 0).astype(np.float16)
        result[camera] = sure, support.expected_range(known, residual_px, scale_error)
    return result


def write_view(
    scene: Scene,
    image: InputImage,
    found: ViewDepth,
    confidence: Confidence | None,
    sources: Sequence[str],
    part: Path,
) -> ViewResult:
    """Write a camera's depth, normals and confidence, with pictures, into `part`, and score the depth."""
    name = f"depth/{image.camera}"
    maps: dict[str, Any] = {"depth": found.depth, "normals": found.normals.astype(np.float16)}
    pictures = {name: colour_depth(found.depth, *display_range(found.depth))}
    if confidence is not None:
        maps[CONFIDENCE] = confidence[0]
        pictures[f"{CONFIDENCE}/{image.camera}"] = colour_confidence(confidence[0])
    for picture, drawn in pictures.items():
        (part / picture).parent.mkdir(exist_ok=True)
        write_image(part / f"{picture}.png", drawn)
    np.savez(part / f"{name}.npz", **maps)
    shares: dict[str, float | None] = {}
    truth = undistorted_truth(scene.dataset, image.view, image.camera, image.instant)
    if truth is not None and scene.unit == "m":
        shares = depth_shares(found.depth, *truth)
    return ViewResult(
        camera=image.camera,
        instant=image.instant,
        sources=tuple(sources),
        coverage=round(float(np.mean(found.depth > 0)), 4),
        depth=f"{name}.npz",
        picture=f"{name}.png",
        expected_within_2pct=None if confidence is None else round(float(confidence[0].mean(dtype=float)), 4),
        expected_range=None if confidence is None else confidence[1],
        **shares,
    )


def measured_fraction(image: InputImage, depth: Array) -> float | None:
    """Return the fraction of an image's moving pixels with depth; None if nothing moves or it is unknown."""
    moving = image.calibrated.moving
    return None if moving is None or not moving.any() else round(float((depth[moving] > 0).mean()), 4)


def write_moment(
    result: MultiviewResult, image: InputImage, depth: Array, cloud: FusedCloud, out: Path
) -> None:
    """Write `FILES` into a folder: the cloud's points, and the page that shows them in 3D.

    `image` and `depth` belong to the reference camera.
    """
    write_ply(out / POINTS, PointCloud(cloud.points, cloud.colours))
    view = image.calibrated.view
    clouds = InstantClouds(
        instant=result.instant,
        synced=POINTS,
        rotation=tuple(view.rotation.ravel().tolist()),
        centre=tuple(view.centre.tolist()),
        focal=view.focal / view.width,
        pivot=tuple(np.median(cloud.points, axis=0).tolist()),
    )
    measured = result.moving_measured
    moving = "" if measured is None else f" {percentage(measured)} of moving pixels have depth."
    page = {
        "title": f"{result.session}, instant {result.instant}",
        "kicker": "One instant in space",
        "name": result.session,
        "verdict": f"{result.fused_points:,} points from {len(result.views)} cameras.{moving} "
        f"{result.basis[0].upper()}{result.basis[1:]}.",
        "numbers_in": (RESULT,),
        "cloud": view_clouds(clouds, out, result.reference, len(result.views)),
        "scripts": ("cloud.js",),
    }
    sections = [Section("cloud.html")]
    if (drawn := out / CONFIDENCE / f"{result.reference}.png").exists():
        pictures = embed_image(out / "depth" / drawn.name), embed_image(drawn)
        sections.append(
            Section("confidence.html", "confidence", "How far to trust it", {"pictures": pictures})
        )
    write_page(render_page(page, sections, __package__), out)
