"""Rendering of views along a path, and their film."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from capture_app.common.errors import NotApplicableError
from capture_app.session.exporting.videos import write_video
from capture_app.session.files.durable import PART, write_atomic
from capture_app.session.files.output_folder import output_errors
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.take_sheet import encode_animation
from reconstruction.common.camera_paths import orbit, read_path, stand_still, swing
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import read_image, write_image
from reconstruction.common.outputs import Made
from reconstruction.depth.backdrop import add_backdrop
from reconstruction.depth.seen_moment import Moment, find_subject, load_moment, save_moment
from reconstruction.depth.view_blending import render
from reconstruction.method.moments import see_moments
from reconstruction.methods.view.view_options import ViewOptions
from reconstruction.methods.view.walk_page import write_moments
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

VIEWS, MAPS, PAGE = "views", "maps", "view.html"
OURS = {VIEWS, MAPS, PAGE}
FPS = 30.0
STILL = "still"
PATHS = {"swing": swing, "orbit": orbit, STILL: stand_still}
_GIF_STEP_MS = 10
"""GIF's unit of time."""


class ViewResult(Provenance, frozen=True, kw_only=True):
    """Views along a path; written to view.json and printed by --json."""

    session: str
    instants: tuple[int, ...]
    """Moments shown: instants, or of n `steps` the instant times n plus the step."""
    steps: int = 1
    """Number of steps of a staggered rig that are moments of their own."""
    condition: str
    cameras: tuple[str, ...]
    frames: int
    width: int
    height: int
    seen: float
    """Mean fraction of the views' pixels that a camera saw; the others are filled from around them."""
    fps: float = FPS
    """Pictures a second of a film of the views."""
    left_out: dict[str, str]


class MadeView(Made[ViewResult]):
    """Views along a path, and the moments that they show."""

    def frame(self, number: int) -> Array:
        """Return a view of the path, uint8 height x width x 3, BGR."""
        return self.image(f"{VIEWS}/{number:06d}.png")

    def render(self, camera: CameraCalibration, instant: int | None = None) -> Array:
        """Return what a camera would see, uint8 height x width x 3, BGR, without distortion.

        `instant` is one of the result's; None = the first.
        """
        view = View.from_calibration(camera, camera.width, camera.height).undistorted
        return render(view, self._moments[self.result.instants[0] if instant is None else instant]).colours

    @cached_property
    def _moments(self) -> dict[int, Moment]:
        return {k: load_moment(self.folder / MAPS / f"{k:06d}") for k in self.result.instants}


def render_views(scene: Scene, condition: Condition, folder: Path, options: ViewOptions) -> ViewResult:
    """Render the views of a path into a folder, and save the moments that they show.

    Raises:
        BadInputError: a file has no path, there is no such instant, or no calibration can be found.
        NotApplicableError: no instant has depth.
    """
    path, progress = options.path, options.progress
    given = _given_path(path)
    unit, dataset = scene.calibration.unit, scene.dataset
    seen, left_out, views = list[int](), dict[str, str](), dict[str, View]()
    steps_ns = dataset.steps_ns
    order_ns = sorted({*steps_ns.values()})
    subject: Array | None = None
    progress.later = 1
    for one in see_moments(
        scene,
        dataset.chosen_instants(options.listed_instants),
        condition,
        quick=options.quick,
        masks=options.masks,
        progress=progress,
    ):
        subject = find_subject(one.moment) if subject is None else subject
        moment = add_backdrop(one.moment)
        for step, delay_ns in enumerate(order_ns):
            if part := {camera: seen for camera, seen in moment.items() if steps_ns[camera] == delay_ns}:
                seen.append(one.instant * len(order_ns) + step)
                save_moment(folder / MAPS / f"{seen[-1]:06d}", part, unit)
        views = views or {camera: seen.view for camera, seen in one.moment.items()}
        left_out |= one.left_out
    if subject is None:
        raise NotApplicableError("no instant has depth", hint="reconstruct multiview says why")
    number = len(seen) if path == STILL else options.frames
    places = given or PATHS[str(path)](views, subject, number)
    (folder / VIEWS).mkdir()
    shown, shares = -1, list[float]()
    progress.step(f"{len(places)} views")
    for number, view in enumerate(places):
        if (now := seen[number * len(seen) // len(places)]) != shown:
            shown, moment = now, load_moment(folder / MAPS / f"{now:06d}")
        picture = render(view, moment)
        write_image(folder / VIEWS / f"{number:06d}.png", picture.colours)
        shares.append(float(picture.known.mean()))
    if options.page:
        moments = {k: load_moment(folder / MAPS / f"{k:06d}") for k in seen}
        write_moments(folder / PAGE, dataset.name, moments, subject, dataset.period_ns // len(order_ns))
    return ViewResult(
        session=dataset.name,
        instants=tuple(seen),
        steps=len(order_ns),
        condition=condition.name,
        cameras=tuple(views),
        frames=len(places),
        width=places[0].width,
        height=places[0].height,
        seen=round(float(np.mean(shares)), 4),
        fps=options.fps or (_recorded_fps(dataset, seen, order_ns) if path == STILL else FPS),
        left_out=left_out,
    )


def write_film(out: Path, folder: Path, result: ViewResult) -> None:
    """Write the views in a folder as one film, atomically, in the format of the file's suffix."""
    fps = result.fps
    frames = (read_image(folder / VIEWS / f"{number:06d}.png") for number in range(result.frames))
    out.parent.mkdir(parents=True, exist_ok=True)
    part = out.with_name(f".{out.name}{PART}")
    with output_errors(out, out.parent):
        if out.suffix.lower() == ".mp4":
            timed = ((round(number * 1e9 / fps), frame) for number, frame in enumerate(frames))
            try:
                write_video(part, timed, (result.width, result.height), round(1e9 / fps))
                part.replace(out)
            finally:
                part.unlink(missing_ok=True)
        else:
            step_ms = max(round(1000 / fps / _GIF_STEP_MS), 2) * _GIF_STEP_MS
            write_atomic(out, encode_animation(list(frames), out.suffix.lower(), step_ms, step_ms))


def _given_path(path: str | Sequence[CameraCalibration]) -> Sequence[View]:
    if not isinstance(path, str):
        return [View.from_calibration(camera, camera.width, camera.height).undistorted for camera in path]
    return [] if path in PATHS else read_path(Path(path))


def _recorded_fps(dataset: Dataset, moments: Sequence[int], steps_ns: Sequence[int]) -> float:
    """Return how many of these moments there were in a second; the usual rate if there is one only."""
    if len(moments) < 2:
        return FPS
    instants, steps = np.divmod([moments[0], moments[-1]], len(steps_ns))
    first_ns, last_ns = np.array(dataset.instants_ns)[instants] + np.array(steps_ns)[steps]
    return round((len(moments) - 1) / float(last_ns - first_ns) * 1e9, 3)
