"""Choice of the depth matcher for all cameras: the plane sweep, or COLMAP's PatchMatch on a GPU."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array, View
from reconstruction.common.matchers import Matcher
from reconstruction.depth.rough_scene import RoughScene
from reconstruction.methods.multiview.colmap_workspace import (
    CudaGpu,
    find_gpu,
    read_maps,
    run_patch_match,
    write_workspace,
)
from reconstruction.methods.multiview.input_images import InputImage
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.methods.multiview.sweep_matcher import ViewDepth, match_all_views

FINDS_MORE = "it finds more than PatchMatch does"


@dataclass(frozen=True)
class ChosenMatcher:
    """The chosen matcher and the reason: PatchMatch on a GPU, or the sweep."""

    gpu: CudaGpu | None = None
    note: str = FINDS_MORE
    quick: bool = False
    """Whether the sweep starts at half the images' size."""

    @property
    def name(self) -> str:
        """Name of the matcher in results."""
        return Matcher.SWEEP if self.gpu is None else Matcher.PATCHMATCH


def choose_matcher(asked: Matcher, *, quick: bool = False) -> ChosenMatcher:
    """Return the requested matcher, see `Matcher.engine`.

    Raises:
        NotAvailableError: PatchMatch is requested, and this machine cannot run it.
    """
    if asked.engine is Matcher.PATCHMATCH:
        gpu = find_gpu()
        return ChosenMatcher(gpu, f"on {gpu[0]}")
    return ChosenMatcher(note=FINDS_MORE if asked is Matcher.AUTO else "asked for", quick=quick)


def match_cameras(
    matcher: ChosenMatcher,
    workspace: Path,
    images: Mapping[str, InputImage],
    sources: Mapping[str, Sequence[str]],
    rough: RoughScene,
    progress: Progress | None = None,
    still: StillScene | None = None,
) -> dict[str, ViewDepth]:
    """Compute depth and normals of every camera; PatchMatch writes a COLMAP workspace with its maps.

    `still` is as in `match_all_views`; PatchMatch does not use it.
    """
    if matcher.gpu is None:
        calibrated = {camera: image.calibrated for camera, image in images.items()}
        views = match_all_views(
            calibrated,
            sources,
            rough.depth_ranges,
            progress,
            has_thin=rough.has_thin,
            quick=matcher.quick,
            still=still,
        )
        return {camera: _inside(images[camera], view) for camera, view in views.items()}
    (progress or Progress(0, silent=True)).step(f"PatchMatch on {matcher.gpu[0]}")
    whole = min(rough.depth_ranges[c][0] for c in images), max(rough.depth_ranges[c][1] for c in images)
    write_workspace(workspace, image_views(images), image_colours(images), depth_range=whole)
    run_patch_match(matcher.gpu, workspace, *whole)
    return read_maps(workspace, images)


def _inside(image: InputImage, depth: ViewDepth) -> ViewDepth:
    """Return a map without what was matched outside the original image, in black."""
    if not (outside := image.outside).any():
        return depth
    return replace(
        depth,
        depth=np.where(outside, 0, depth.depth),
        normals=np.where(outside[..., None], 0, depth.normals),
    )


def image_views(images: Mapping[str, InputImage]) -> dict[str, View]:
    """Return the undistorted view of each camera."""
    return {camera: image.calibrated.view for camera, image in images.items()}


def image_colours(images: Mapping[str, InputImage]) -> dict[str, Array]:
    """Return the undistorted image of each camera."""
    return {camera: image.colours for camera, image in images.items()}
