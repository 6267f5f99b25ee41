"""Splats of a session's instants, each beginning with what the instant before has learned."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.format.calibration import CameraCalibration
from reconstruction.common.camera_paths import frame_of
from reconstruction.common.geometry import Array, View
from reconstruction.common.outputs import Made
from reconstruction.compare.moments import see_moments
from reconstruction.depth.seen_moment import find_subject
from reconstruction.methods.splat.gaussians import (
    Gaussians,
    make_gaussians,
    read_splats,
    render_gaussians,
    write_splats,
)
from reconstruction.methods.splat.optimization import optimize
from reconstruction.methods.splat.splat_method import SplatMethod
from reconstruction.methods.splat.splat_page import write_splat_page
from reconstruction.report.walk_page import PAGE
from reconstruction.scene.conditions import Condition
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene
from reconstruction.scores.picture_quality import psnr

SPLATS = "splats"
OURS = {SPLATS, PAGE}
SAME = 1e-3
"""Relative distance within which a pixel's surface is where it was at the instant before."""


class SplatInstant(Struct, frozen=True, kw_only=True):
    """The splat of one instant."""

    instant: int
    file: str
    gaussians: int
    psnr: float
    """Mean over the pictures that it was made from, dB."""


class SplatResult(Provenance, frozen=True, kw_only=True):
    """Splats; written to splat.json and printed by --json."""

    session: str
    condition: str
    cameras: tuple[str, ...]
    unit: str
    iterations: int
    instants: tuple[SplatInstant, ...]
    left_out: dict[str, str]


class MadeSplat(Made[SplatResult]):
    """Splats of instants."""

    def gaussians(self, instant: int | None = None) -> Gaussians:
        """Return the Gaussians of an instant; None = the first. Raises BadInputError if it has no splat."""
        found = {one.instant: one.file for one in self.result.instants}
        wanted = self.result.instants[0].instant if instant is None else instant
        if wanted not in found:
            raise BadInputError(f"instant {wanted} has no splat", hint=f"there are {sorted(found)}")
        return read_splats(self.folder / found[wanted])

    def render(self, camera: CameraCalibration, instant: int | None = None) -> Array:
        """Return what a camera would see of a splat, uint8 height x width x 3, BGR, without distortion."""
        view = View.from_calibration(camera, camera.width, camera.height).undistorted
        return render_gaussians(self._first if instant is None else self.gaussians(instant), view)

    @cached_property
    def _first(self) -> Gaussians:
        return self.gaussians()


@dataclass(frozen=True, eq=False)
class _Learned:
    """What an optimization changed: Gaussians before and after, for the instant that follows."""

    before: Gaussians
    after: Gaussians

    def begin(self, gaussians: Gaussians) -> Gaussians:
        """Return Gaussians with what was learned of the same pixels' surfaces, where these stand still."""
        places = np.searchsorted(self.after.pixels, gaussians.pixels).clip(0, len(self.after) - 1)
        same = self.after.pixels[places] == gaussians.pixels
        there = self.after.places[places]
        far = np.linalg.norm(gaussians.places, axis=1)
        same &= np.linalg.norm(there - gaussians.places, axis=1) < SAME * far
        # Sizes of two pixels merged into one Gaussian are not those of one pixel.
        same &= np.abs(self.before.sizes[places, 0] / gaussians.sizes[:, 0] - 1) < 0.1
        changed = self.after.colours[places] - self.before.colours[places]
        grown = self.after.sizes[places] / self.before.sizes[places]
        return replace(
            gaussians,
            colours=np.where(same[:, None], np.clip(gaussians.colours + changed, 0, 1), gaussians.colours),
            opacities=np.where(same, self.after.opacities[places], gaussians.opacities),
            sizes=np.where(same[:, None], gaussians.sizes * grown, gaussians.sizes),
        )


def make_splats(
    scene: Scene, condition: Condition, options: SplatMethod, folder: Path, progress: Progress
) -> SplatResult:
    """Write a splat of each chosen instant into a folder.

    Raises:
        IncompleteError: the session is not calibrated.
        BadInputError: there is no such instant.
        NotApplicableError: no instant has depth.
    """
    unit, dataset = scene.require_calibration().unit, scene.dataset
    made, left_out, views = list[SplatInstant](), dict[str, str](), dict[str, View]()
    learned: _Learned | None = None
    subject: Array | None = None
    chosen = dataset.chosen_instants(options.listed_instants)
    for one in see_moments(scene, chosen, condition, quick=options.quick, progress=progress):
        if not made:
            progress.total = progress.done + len(chosen)  # all maps are computed
        progress.step(f"splat of instant {one.instant}")
        moment = {camera: seen.resized(options.width) for camera, seen in one.moment.items()}
        begun = make_gaussians(moment)
        begun = begun.chosen(np.argsort(begun.pixels, kind="stable"))
        start = learned.begin(begun) if learned is not None else begun
        splat, kept = optimize(start, moment, options.iterations)
        learned = _Learned(begun.chosen(kept), splat)
        file = f"{SPLATS}/{one.instant:06d}.ply"
        write_splats(folder / file, splat)
        found_db = [psnr(render_gaussians(splat, seen.view), seen.colours) for seen in moment.values()]
        made.append(
            SplatInstant(
                instant=one.instant, file=file, gaussians=len(splat), psnr=round(float(np.mean(found_db)), 2)
            )
        )
        left_out |= one.left_out
        views |= {camera: seen.view for camera, seen in moment.items()}
        subject = find_subject(moment) if subject is None else subject
    if subject is None:
        raise NotApplicableError("no instant has depth", hint="reconstruct multiview says why")
    if options.page:
        files = {one.instant: folder / one.file for one in made}
        write_splat_page(folder, dataset.name, files, frame_of(views, subject), views, dataset.period_ns)
    return SplatResult(
        session=dataset.name,
        condition=condition.name,
        cameras=tuple(views),
        unit=unit,
        iterations=options.iterations,
        instants=tuple(made),
        left_out=left_out,
    )
