"""Depth of all cameras at an instant, in memory: the result that a command writes and a comparison scores."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from capture_app.session.format.camera_labels import require_camera
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.rough_scene import RoughScene, find_rough_scene
from reconstruction.depth.seen_moment import Moment, SeenView
from reconstruction.depth.view_choice import (
    choose_reference_view,
    choose_source_views,
    refuse_views,
    seen_points,
    smallest_group,
)
from reconstruction.method.interface import SILENT
from reconstruction.methods.multiview.colmap_workspace import write_workspace
from reconstruction.methods.multiview.confidence import measure_support
from reconstruction.methods.multiview.fusion import FusedCloud, fuse_maps
from reconstruction.methods.multiview.input_images import InputImage, InputImages
from reconstruction.methods.multiview.matcher import image_colours, image_views, match_cameras
from reconstruction.methods.multiview.multiview_options import MultiviewOptions
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.conditions import Condition
from reconstruction.scene.instant_choice import instants_shown


@dataclass(frozen=True, eq=False)
class InstantMaps:
    """The images of one instant that have depth, the cameras that each was matched with, and the depth."""

    instant: int
    images: Mapping[str, InputImage]
    sources: Mapping[str, Sequence[str]]
    rough: RoughScene
    maps: Mapping[str, ViewDepth]
    left_out: Mapping[str, str]
    """Cameras without depth, with the reasons."""
    usable: Mapping[str, InputImage]
    """All images that could be matched, also those without depth."""

    @property
    def reference(self) -> str:
        """The camera in the middle, whose image overlaps most with the others."""
        return choose_reference_view(image_views(self.images), self.rough.points)

    @cached_property
    def cloud(self) -> FusedCloud:
        """The maps fused into one cloud."""
        views, colours = image_views(self.images), image_colours(self.images)
        return fuse_maps(views, self.maps, colours, smallest_group(self.sources))

    def moment(self, min_evidence: float | None = None) -> Moment:
        """Return the cameras with their pictures and depth, without depth of less evidence than given."""
        depth = {camera: view.depth for camera, view in self.maps.items()}
        if min_evidence is not None:
            calibrated = {camera: image.calibrated for camera, image in self.images.items()}
            for camera, support in measure_support(calibrated, self.sources, self.maps):
                depth[camera] = np.where(support.evidence >= min_evidence, depth[camera], 0)
        return {
            camera: SeenView(
                image.calibrated.view,
                image.colours,
                depth[camera],
                self.maps[camera].normals.astype(np.float16).astype(np.float32),
            )
            for camera, image in self.images.items()
        }


def match_instants(
    inputs: InputImages,
    instants: Sequence[int],
    condition: Condition,
    options: MultiviewOptions,
) -> Iterator[InstantMaps]:
    """Yield the depth of each instant under a condition; several share what stands still.

    Of several, an instant that cannot be reconstructed is left out.

    Raises:
        BadInputError: there is no such instant, or none has depth.
    """
    still, seen, many, progress = StillScene(), False, len(instants) > 1, options.progress
    if many:
        progress.total = len(instants) + progress.later
    for instant in instants:
        if many:
            progress.step(f"instant {instant}")
        try:
            maps = match_instant(inputs, instant, condition, options, still, SILENT if many else progress)
        except BadInputError:
            if seen or instant != instants[-1]:
                continue
            raise
        seen = True
        yield maps


def match_instant(
    inputs: InputImages,
    instant: int,
    condition: Condition,
    options: MultiviewOptions,
    still: StillScene,
    progress: Progress,
    *,
    workspace: Path | None = None,
    on_pair: Callable[[CalibratedImage, CalibratedImage, tuple[float, float]], None] | None = None,
) -> InstantMaps:
    """Compute the depth of an instant's images under a condition, by those of their step.

    `still` is the still scene found at earlier instants; it also stores the new results. COLMAP's workspace
    is written to `workspace` if given.
    `on_pair` receives two images and their range of depth before all are matched.

    Raises:
        BadInputError: no two cameras can measure depth.
    """
    shown = instants_shown(inputs.dataset, condition, instant)
    without = {require_camera(text, inputs.dataset.labels, "--without") for text in options.without}
    usable, left_out = inputs.usable({c: k for c, k in shown.items() if c not in without})
    progress.total = 1 + len(usable) + progress.later
    progress.step("the scene's range of depth")
    calibrated = {camera: image.calibrated for camera, image in usable.items()}
    still.look(calibrated)
    rough = still.scene = still.scene or find_rough_scene(calibrated)
    views = {camera: calibrated[camera].view for camera in rough.points}
    steps_ns = {camera: image.step_ns for camera, image in usable.items()}
    sources = choose_source_views(views, rough.points, steps_ns)
    if not any(sources.values()):
        raise refuse_views(views, rough.points)
    left_out |= {c: _why_alone(c, calibrated, rough, steps_ns) for c in usable if not sources.get(c)}
    images = {camera: image for camera, image in usable.items() if sources.get(camera)}
    progress.done += len(usable) - len(images)
    if on_pair is not None:
        reference = choose_reference_view(image_views(images), rough.points)
        on_pair(calibrated[reference], calibrated[sources[reference][0]], rough.depth_ranges[reference])
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        maps = match_cameras(
            options.chosen_matcher,
            workspace or Path(scratch),
            images,
            sources,
            rough,
            progress,
            still,
        )
    if workspace is not None and options.chosen_matcher.gpu is None:
        write_workspace(workspace, image_views(images), image_colours(images), maps)
    return InstantMaps(instant, images, sources, rough, maps, left_out, usable)


def _why_alone(
    camera: str, images: Mapping[str, CalibratedImage], scene: RoughScene, steps_ns: Mapping[str, int]
) -> str:
    """Return why a camera has no sources."""
    if camera not in scene.points:
        return "nothing in its picture could be matched in another camera's picture"
    if not any(steps_ns[other] == steps_ns[camera] for other in images if other != camera):
        return "no other camera takes its frames at the same time"
    inside = {
        other: seen_points(images[camera].view, images[other].view, scene.points[camera])
        for other in images
        if other != camera and steps_ns[other] == steps_ns[camera]
    }
    best = max(inside, key=lambda other: float(inside[other][0].mean()))
    there, angles = inside[best]
    return (
        f"no other camera suits its depth: {best} sees the most of its picture, {100 * there.mean():.0f} %, "
        f"from an angle of {float(np.median(angles)):.1f} degrees"
    )
