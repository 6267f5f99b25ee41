"""`reconstruct multiview --instants`: clouds of many instants, motion masks, and a Rerun recording.

The folder grows cloud by cloud, and a stopped run can be resumed. `plan.json` holds the inputs and settings;
`instants/<instant>.json` marks an instant as done.
"""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self, TypeVar

import msgspec
import numpy as np
from msgspec import Struct

from capture_app.common import system
from capture_app.common.errors import BadInputError
from capture_app.common.text import pretty_json
from capture_app.session.exporting.exported_burst import mask_path
from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.exporting.rerun_stream import rerun_recording, set_times
from capture_app.session.files.durable import PART, sync_folder, write_atomic
from capture_app.session.files.output_folder import growing_folder, output_errors
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.reading.decoding import JPEG_BEGIN
from reconstruction.method.interface import SILENT
from reconstruction.methods.multiview.input_images import InputImages, prepare_images
from reconstruction.methods.multiview.instant_model import model_instant
from reconstruction.methods.multiview.multiview_options import MultiviewOptions
from reconstruction.methods.multiview.result import FUSED, SequenceInstant, SequenceResult
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import write_masks
from reconstruction.scene.provenance import with_provenance
from reconstruction.scene.scene import Scene

RECORDING = "sequence.rrd"
RESULT = "sequence.json"
PLAN = "plan.json"
INSTANTS, CLOUDS, MESHES, DEPTH, MASKS = "instants", "clouds", "meshes", "depth", "movers"
_WORK, _LOCK = ".work", ".lock"
_BEGUN = {PLAN, f"{PLAN}{PART}", _WORK, _LOCK}
OURS = _BEGUN | {RESULT, INSTANTS, CLOUDS, MESHES, DEPTH, MASKS, CALIBRATION, RECORDING}
OURS |= {f"{RESULT}{PART}", f"{CALIBRATION}{PART}"}
"""Includes partial files that a killed run leaves."""

SETTINGS = "depth", "quick", "whole", "without", "width"
"""Options that determine the clouds."""

Form = TypeVar("Form", bound=Struct)


def write_recording(
    file: Path, out: Path, dataset: Dataset, calibration: Calibration, instants: Sequence[SequenceInstant]
) -> None:
    """Write `cloud` (files in `out`) and `rig/<camera>` on the timelines `leader` and `instant`.

    Only one instant is in memory at a time. Raises NotAvailableError without rerun-sdk.
    """
    with rerun_recording(dataset.name, file, calibration.cameras) as (rerun, stream):
        for made in instants:
            set_times(stream, made.leader_ns, made.instant)
            cloud = read_ply(out / made.cloud)
            stream.log("cloud", rerun.Points3D(cloud.points, colors=cloud.colours))
            for camera in dataset.cameras:
                if camera in calibration.cameras and dataset.has_image(camera, made.instant):
                    picture = dataset.image_bytes(camera, made.instant)
                    kind = "image/jpeg" if picture.startswith(JPEG_BEGIN) else "image/png"
                    stream.log(f"rig/{camera}", rerun.EncodedImage(contents=picture, media_type=kind))


class SequencePlan(Struct, frozen=True, kw_only=True):
    """Inputs and settings of a folder's clouds; clouds of another plan do not belong among them."""

    session: str
    pictures: str
    """Fingerprint of the images and the calibration."""
    condition: str
    matcher: str
    mesh: bool = msgspec.field(name="meshes")
    time_shifts_ms: dict[str, float]
    depth: bool
    quick: bool = False
    whole: bool = True
    without: tuple[str, ...] = ()
    width: int | None = None

    def difference(self, earlier: "SequencePlan") -> str:
        """Describe the first setting in which an earlier plan differs; empty if they are equal."""
        for name in self.__struct_fields__:
            was, now = getattr(earlier, name), getattr(self, name)
            if was != now:
                if isinstance(was, bool):
                    return f"made {'with' if was else 'without'} --{name}"
                return f"of {name.replace('_', ' ')} {was!r}, not {now!r}"
        return ""


class SequenceFolder:
    """Folder of a sequence, which this run alone writes to."""

    def __init__(self, out: Path, plan: SequencePlan) -> None:
        """Remove unfinished work of a killed run. Raises BadInputError for clouds with other settings."""
        self.out = out
        earlier = _read(out / PLAN, SequencePlan)
        if earlier is None and (out / PLAN).exists():
            raise BadInputError(f"{out / PLAN} is broken", hint="choose a new folder for --out")
        if earlier is not None and self._has_clouds() and (other := plan.difference(earlier)):
            raise BadInputError(
                f"{out} holds clouds {other}", hint="use the same options, or choose a new folder for --out"
            )
        shutil.rmtree(out / _WORK, ignore_errors=True)
        for part in list(out.rglob(f"*{PART}")):
            part.unlink()
        if earlier != plan:
            self._clear()
            write_atomic(out / PLAN, pretty_json(plan))
        for folder in (INSTANTS, CLOUDS):
            (out / folder).mkdir(exist_ok=True)

    @classmethod
    @contextmanager
    def opened(cls, out: Path, plan: SequencePlan) -> Iterator[Self]:
        """Open a folder, and create it if missing; at the end remove it if it has no cloud.

        Raises as `growing_folder` and the constructor do.
        """
        with growing_folder(out, _LOCK, OURS if (out / PLAN).exists() else _BEGUN) as root:
            folder = cls(root, plan)
            try:
                # Cleanup frees space, so the free space is checked before it.
                with output_errors(root, root):
                    yield folder
            finally:
                shutil.rmtree(root / _WORK, ignore_errors=True)
                if not folder._has_clouds():
                    folder._clear()

    def done(self, instant: int) -> SequenceInstant | None:
        """Return the result of an instant; None if its cloud is not computed yet."""
        done = _read(self._record(instant), SequenceInstant)
        return done if done and done.cloud and (self.out / done.cloud).is_file() else None

    def finish(self, done: SequenceInstant) -> None:
        """Mark an instant as done by saving its result, once its cloud is saved."""
        write_atomic(self._record(done.instant), pretty_json(done))

    def calibration(self) -> Calibration | None:
        """Return the calibration that an earlier run estimated for this folder, as its session has none."""
        return _read(self.out / CALIBRATION, Calibration)

    @property
    def files(self) -> tuple[str, ...]:
        """Return the names of the files and folders of a finished sequence."""
        return tuple(sorted({RESULT} | {path.name for path in self.out.iterdir()} - {_WORK, _LOCK}))

    def empty_work(self) -> Path:
        """Return an empty work folder; it is removed at the end, or when a killed run is resumed."""
        shutil.rmtree(self.out / _WORK, ignore_errors=True)
        (self.out / _WORK).mkdir()
        return self.out / _WORK

    def take_over(self, name: str) -> None:
        """Move a result from the work folder into its place."""
        (self.out / _WORK / name).replace(self.out / name)
        sync_folder(self.out)

    def _record(self, instant: int) -> Path:
        return self.out / INSTANTS / f"{instant:06d}.json"

    def _has_clouds(self) -> bool:
        return any((self.out / CLOUDS).glob("*.ply"))

    def _clear(self) -> None:
        """Remove files that are useless without clouds."""
        for folder in (INSTANTS, CLOUDS, MESHES, DEPTH, MASKS):
            shutil.rmtree(self.out / folder, ignore_errors=True)
        # The plan is removed last: it marks the remaining files as ours for the next run.
        for file in (CALIBRATION, RECORDING, RESULT, PLAN):
            (self.out / file).unlink(missing_ok=True)


def _read(path: Path, form: type[Form]) -> Form | None:
    """Read one of our files; None if it is missing or corrupt."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=form)
    except (FileNotFoundError, msgspec.MsgspecError):
        return None


def model_sequence(
    scene: Scene,
    out: Path,
    condition: Condition,
    options: MultiviewOptions,
) -> SequenceResult:
    """Compute a cloud of each of the instants in `out`; existing clouds are reused.

    An instant that cannot be reconstructed is left out, with the reason.

    Raises:
        BadInputError: the session or an instant cannot be used, `out` has other contents, or no instant gave
            a cloud.
        TryAgainError: another run is writing to `out`.
    """
    began = system.monotonic_s()
    dataset, chosen = scene.dataset, scene.dataset.chosen_instants(options.instants)
    progress, matcher = options.progress, options.chosen_matcher.name
    plan = SequencePlan(
        session=dataset.name,
        pictures=dataset.fingerprint(scene.given),
        condition=condition.name,
        matcher=matcher,
        mesh=options.makes_mesh,
        time_shifts_ms=dict(options.time_shifts_ms),
        **{name: getattr(options, name) for name in SETTINGS},
    )
    # Only saved maps have a confidence, which needs the check.
    each = msgspec.structs.replace(
        options, cloud=False, workspace=False, check=options.depth, progress=SILENT
    )
    with SequenceFolder.opened(out, plan) as folder:
        still = StillScene()
        missing_masks = not (out / MASKS).is_dir() and all(
            len(dataset.instants(camera)) > 1 for camera in dataset.cameras
        )
        progress.total = len(dataset.cameras) * missing_masks + len(chosen) + options.rrd
        if missing_masks:
            write_masks(scene.motion, folder.empty_work() / MASKS, progress)
            folder.take_over(MASKS)
        scene = _calibrated(scene, folder)
        inputs = prepare_images(scene, options.width)
        earlier = {k: done for k in chosen if (done := folder.done(k)) is not None}
        progress.done += len(earlier)
        every = []
        for instant in chosen:
            if instant not in earlier:
                progress.step(f"instant {instant}")
            if options.whole:
                still = StillScene()
            every.append(earlier.get(instant) or _make(inputs, still, each, condition, instant, folder))
        if not any(made.cloud for made in every):
            raise BadInputError(
                f"no instant gave a cloud; instant {every[0].instant}: {every[0].reason}",
                hint="choose other --instants, or calibrate the rig again",
            )
        if options.rrd:
            progress.step("the recording")
            clouds = [made for made in every if made.cloud]
            write_recording(folder.empty_work() / RECORDING, out, dataset, scene.calibration, clouds)
            folder.take_over(RECORDING)
        scores = [made.movers_1cm.f_score for made in every if made.movers_1cm is not None]
        result = SequenceResult(
            session=dataset.name,
            condition=condition.name,
            matcher=matcher,
            calibration=scene.source,
            unit=scene.unit,
            instants=tuple(every),
            clouds=sum(bool(made.cloud) for made in every),
            mover_f_score_1cm=_median(scores),
            mover_within_2pct=_median([made.mover_within_2pct for made in every]),
            within_2pct=_median([made.within_2pct for made in every]),
            labels=dataset.other_labels,
            kept=len(earlier),
            masks=(out / MASKS).is_dir(),
            files=folder.files,
        )
        result = with_provenance(result, began, options.time_shifts_ms)
        write_atomic(out / RESULT, pretty_json(result))
    return result


def cloud_file(instant: int) -> str:
    """Return the path of an instant's cloud; the names form a sequence that viewers can play."""
    return f"{CLOUDS}/{instant:06d}.ply"


def _calibrated(scene: Scene, folder: SequenceFolder) -> Scene:
    """Return the scene with a calibration: if none was given, one that all runs to this folder share."""
    if scene.given is not None:
        return scene
    if (calibration := folder.calibration()) is None:
        calibration = scene.calibration
        write_atomic(folder.out / CALIBRATION, pretty_json(calibration))
    return scene.calibrated(calibration)


def _make(
    inputs: InputImages,
    still: StillScene,
    options: MultiviewOptions,
    condition: Condition,
    instant: int,
    folder: SequenceFolder,
) -> SequenceInstant:
    """Compute an instant in the work folder, move its files into place, then mark it as done."""
    work, out, dataset, began_s = folder.empty_work(), folder.out, inputs.dataset, system.monotonic_s()
    leader_ns = dataset.instants_ns[instant]
    try:
        model = model_instant(inputs, condition, instant, options, work, still=still)
    except BadInputError as error:
        done = SequenceInstant(instant=instant, leader_ns=leader_ns, reason=str(error))
    else:
        _place(work / FUSED, out / cloud_file(instant))
        if model.mesh_triangles:
            _place(work / "mesh.ply", out / MESHES / f"{instant:06d}.ply")
        for view in model.views if options.depth else ():
            _place(work / view.depth, mask_path(out / DEPTH, view.camera, instant).with_suffix(".npz"))
        done = SequenceInstant(
            instant=instant,
            leader_ns=leader_ns,
            cloud=cloud_file(instant),
            points=model.fused_points,
            reference=model.reference,
            coverage=model.coverage,
            within_2pct=model.within_2pct,
            mover_within_2pct=model.mover_within_2pct,
            movers_1cm=model.movers_1cm,
            left_out=model.left_out,
            seconds=round(system.monotonic_s() - began_s, 3),
        )
        folder.finish(done)
    return done


def _place(file: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(target, file.read_bytes())


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None
