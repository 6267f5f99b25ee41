"""Splats of a session's instants, each beginning with what the instant before has learned."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.session.format.calibration import CameraCalibration
from reconstruction.common.camera_paths import frame_of
from reconstruction.common.geometry import Array, View
from reconstruction.common.outputs import Made
from reconstruction.depth.backdrop import Backdrop, find_backdrop
from reconstruction.depth.seen_moment import SeenInstant, SeenView, find_subject
from reconstruction.method.moments import read_mask
from reconstruction.method.picture_quality import psnr
from reconstruction.methods.splat.gaussians import (
    Gaussians,
    make_gaussians,
    read_splats,
    render_gaussians,
    write_splats,
    write_spz,
)
from reconstruction.methods.splat.optimization import optimize
from reconstruction.methods.splat.splat_options import SplatOptions
from reconstruction.methods.splat.splat_page import write_splat_page
from reconstruction.scene.conditions import Condition
from reconstruction.scene.instant_choice import instants_shown
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

SPLATS, PAGE = "splats", "splat.html"
OURS = {SPLATS, PAGE}
MIN_CAMERAS = 4
"""Depth takes three; the fourth is left out."""
SAME = 4e-3
"""Relative distance within which a pixel's surface is where it was at the instant before."""


class SplatInstant(Struct, frozen=True, kw_only=True):
    """The splat of one instant."""

    instant: int
    file: str
    gaussians: int
    psnr: float
    """Mean over the pictures that it was made from, dB."""
    held_out_psnr: float | None = None
    """Of the camera that was left out, dB; None if there is none, or it has no picture."""


class SplatResult(Provenance, frozen=True, kw_only=True):
    """Splats; written to splat.json and printed by --json."""

    session: str
    condition: str
    cameras: tuple[str, ...]
    unit: str
    iterations: int
    held_out: str = ""
    """The camera that was left out, whose picture judges the splats; empty if all were used."""
    instants: tuple[SplatInstant, ...]
    left_out: dict[str, str]


class MadeSplat(Made[SplatResult]):
    """Splats of instants."""

    def gaussians(self, instant: int | None = None) -> Gaussians:
        """Return the Gaussians of an instant; None = the first. Raises BadInputError if it has no splat."""
        files = {moment.instant: moment.file for moment in self.result.instants}
        chosen = self.result.instants[0].instant if instant is None else instant
        if chosen not in files:
            raise BadInputError(f"instant {chosen} has no splat", hint=f"there are {sorted(files)}")
        return read_splats(self.folder / files[chosen])

    def render(self, camera: CameraCalibration, instant: int | None = None) -> Array:
        """Return what a camera would see of a splat, uint8 height x width x 3, BGR, without distortion."""
        view = View.from_calibration(camera, camera.width, camera.height).undistorted
        return render_gaussians(self._first if instant is None else self.gaussians(instant), view)

    @cached_property
    def _first(self) -> Gaussians:
        return self.gaussians()


def middle_camera(views: Mapping[str, View]) -> str:
    """Return the camera nearest to the middle of all; empty if they are fewer than `MIN_CAMERAS`."""
    if len(views) < MIN_CAMERAS:
        return ""
    middle = np.mean([view.centre for view in views.values()], axis=0)
    return min(views, key=lambda name: float(np.linalg.norm(views[name].centre - middle)))


def _with_learned(gaussians: Gaussians, before: Gaussians, after: Gaussians) -> Gaussians:
    """Return Gaussians with what an optimization changed on the same pixels' surfaces, where these are still.

    Those stay where they were, so that noise of the maps moves nothing.

    `before` and `after` are the Gaussians of the instant before.
    """
    places = np.searchsorted(after.pixels, gaussians.pixels).clip(0, len(after) - 1)
    same = after.pixels[places] == gaussians.pixels
    far = np.linalg.norm(gaussians.places, axis=1)
    same &= np.linalg.norm(after.places[places] - gaussians.places, axis=1) < SAME * far
    # Sizes of two pixels merged into one Gaussian are not those of one pixel.
    same &= np.abs(before.sizes[places, 0] / gaussians.sizes[:, 0] - 1) < 0.1
    changed = after.colours[places] - before.colours[places]
    grown = after.sizes[places] / before.sizes[places]
    return replace(
        gaussians,
        places=np.where(same[:, None], after.places[places], gaussians.places),
        axes=np.where(same[:, None, None], after.axes[places], gaussians.axes),
        colours=np.where(same[:, None], np.clip(gaussians.colours + changed, 0, 1), gaussians.colours),
        opacities=np.where(same, after.opacities[places], gaussians.opacities),
        sizes=np.where(same[:, None], gaussians.sizes * grown, gaussians.sizes),
    )


SplatMoment = tuple[SeenInstant, Gaussians]
"""An instant in the size that its splat was made from, and the splat."""


def optimize_moments(seen: Iterable[SeenInstant], count: int, options: SplatOptions) -> Iterator[SplatMoment]:
    """Yield the splat of each of `count` instants, beginning with what the instant before has learned."""
    learned: tuple[Gaussians, ...] = ()
    backdrop: Backdrop | None = None
    options.progress.later = count
    for one in seen:
        options.progress.step(f"splat of instant {one.instant}")
        moment = {camera: view.resized(options.width) for camera, view in one.moment.items()}
        # What is beyond all surfaces stands still.
        if not learned and options.masks is None:
            backdrop = find_backdrop(moment)
        begun = make_gaussians(moment, backdrop)
        begun = begun.chosen(np.argsort(begun.pixels, kind="stable"))
        known = _with_learned(begun, *learned) if learned else begun
        splat, visible = optimize(known, moment, options.iterations)
        learned = begun.chosen(visible), splat
        yield one._replace(moment=moment), splat


def make_splats(
    scene: Scene,
    splats: Iterable[SplatMoment],
    folder: Path,
    condition: Condition,
    options: SplatOptions,
    *,
    held_out: str,
) -> SplatResult:
    """Write splats into a folder, and as .spz and a page that shows them if asked for.

    The picture of the camera `held_out`, empty = none, is compared with each splat.

    Raises:
        NotApplicableError: no instant has depth.
    """
    made, left_out, views = list[SplatInstant](), dict[str, str](), dict[str, View]()
    dataset, masked = scene.dataset, options.masks is not None
    subject: Array | None = None
    for one, splat in splats:
        file = f"{SPLATS}/{one.instant:06d}.ply"
        write_splats(folder / file, splat)
        if options.spz:
            write_spz((folder / file).with_suffix(".spz"), splat)
        shown, judge_db = instants_shown(dataset, condition, one.instant).get(held_out), None
        if shown is not None and dataset.has_image(held_out, shown):
            judge_db = _mean_psnr(splat, [_picture(scene, held_out, shown, options)], masked=masked)
        made.append(
            SplatInstant(
                instant=one.instant,
                file=file,
                gaussians=len(splat),
                psnr=_mean_psnr(splat, one.moment.values(), masked=masked),
                held_out_psnr=judge_db,
            )
        )
        left_out |= one.left_out
        views |= {camera: seen.view for camera, seen in one.moment.items()}
        subject = find_subject(one.moment) if subject is None else subject
    if subject is None:
        raise NotApplicableError("no instant has depth", hint="reconstruct multiview says why")
    if options.page:
        files = {moment.instant: folder / moment.file for moment in made}
        write_splat_page(
            folder / PAGE, dataset.name, files, frame_of(views, subject), views, dataset.period_ns
        )
    return SplatResult(
        session=dataset.name,
        condition=condition.name,
        cameras=tuple(views),
        unit=scene.unit,
        iterations=options.iterations,
        held_out=held_out,
        instants=tuple(made),
        left_out=left_out,
    )


def _mean_psnr(splat: Gaussians, pictures: Iterable[SeenView], *, masked: bool) -> float:
    """Return the mean PSNR, dB, of what cameras see of a splat; of masked pictures, where not black."""
    found_db = [
        psnr(
            render_gaussians(splat, seen.view),
            seen.colours,
            np.asarray(seen.colours.any(axis=2)) if masked else None,
        )
        for seen in pictures
    ]
    return round(float(np.mean(found_db)), 2)


def _picture(scene: Scene, camera: str, instant: int, options: SplatOptions) -> SeenView:
    """Return a camera's picture without depth, reduced and masked like those that splats are made from."""
    view = scene.views[camera]
    colours = view.undistort_image(scene.dataset.image(camera, instant))
    depth = np.zeros(colours.shape[:2], np.float32)
    seen = SeenView(view.undistorted, colours, depth, np.zeros_like(colours))
    if options.masks is not None:
        seen = seen.within(read_mask(scene, options.masks, camera, instant))
    return seen.resized(options.width)
