"""Depth of every camera of an instant, one cloud of points of them all, and a mesh."""

import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import cv2
import msgspec
import numpy as np

from capture_app.errors import BadInputError, NotAvailableError
from capture_app.session.durable import write_whole
from reconstruction.colmap_maps import read_maps
from reconstruction.dataset import Dataset
from reconstruction.depth_range import find_depth_range
from reconstruction.geometry import Array
from reconstruction.matcher import DepthView, match_views
from reconstruction.mesh import Model, build_model, up_of
from reconstruction.multiview_input import Shot, instants_of, load_shots
from reconstruction.multiview_result import MultiviewResult, ViewResult
from reconstruction.native import versions
from reconstruction.patchmatch import Gpu, find_gpu, run_patch_match
from reconstruction.photo import Photo
from reconstruction.pictures import colour_depth
from reconstruction.pipeline import Progress
from reconstruction.sources import choose_sources, guessed_depths, reference_of
from reconstruction.workspace import fuse, write_workspace

RESULT = "multiview.json"
OURS = {RESULT, "depth", "workspace", "fused.ply", "fused.ply.vis", "cloud.ply", "mesh.ply", "turntable.png"}
ERROR_SHARE = 0.02


class Matcher(StrEnum):
    """Who finds the depth: this package on the CPU, COLMAP on a GPU, or COLMAP where there is a GPU."""

    AUTO = "auto"
    SWEEP = "sweep"
    PATCHMATCH = "patchmatch"


@dataclass(frozen=True, kw_only=True)
class MultiviewOptions:
    """What to make: `offsets_ms` are one for each camera in the session's order, or none."""

    instant: int = 0
    offsets_ms: tuple[float, ...] = ()
    matcher: Matcher = Matcher.AUTO
    mesh: bool = True


@dataclass
class _Clock:
    """Wall seconds of the stages."""

    seconds: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter)
    last: float = field(default_factory=time.perf_counter)

    def stage(self, name: str) -> None:
        """What ran since the last call was this stage."""
        now = time.perf_counter()
        self.seconds[name] = round(now - self.last, 3)
        self.last = now

    def total(self) -> float:
        """Seconds since the start."""
        return round(time.perf_counter() - self.started, 3)


def multiview(
    session: Path, out: Path, options: MultiviewOptions, progress: Progress | None = None
) -> MultiviewResult:
    """Make the depth, the cloud and the mesh of one instant; `out` appears whole or not at all.

    Raises:
        BadInputError: the session, the instant or the offsets cannot be used, or nothing was found.
        NotAvailableError: the matcher asked for, or COLMAP or Open3D, is not here.
    """
    _refuse_foreign(out)
    gpu, note = _choose(options.matcher)
    clock = _Clock()
    dataset = Dataset.open(session)
    instants = instants_of(dataset, options.instant, options.offsets_ms)
    shots, left_out, calibration, unit = load_shots(dataset, instants)

    def say(text: str) -> None:
        if progress is not None:
            progress.total = len(shots) + (3 if options.mesh else 2)
            progress.step(text)

    say("how near and how far the scene is")
    photos = {camera: shot.photo for camera, shot in shots.items()}
    guess = choose_sources({c: p.view for c, p in photos.items()}, _guess(photos))
    if not any(guess.values()):
        raise BadInputError(
            "no camera sees what another sees",
            hint="turn the cameras to the same scene, or check the calibration",
        )
    nearest, farthest = find_depth_range(photos, guess)
    views = {camera: photo.view for camera, photo in photos.items()}
    depths = (nearest, 2 / (1 / nearest + 1 / farthest), farthest)
    sources = choose_sources(views, depths)
    clock.stage("range")
    part = out.absolute().with_name(f".{out.name}.{os.getpid()}.part")
    try:
        _make_folder(part)
        found = _match(gpu, part, shots, sources, (nearest, farthest), say)
        clock.stage("matching")
        for camera in shots:
            if camera not in found:
                left_out[camera] = "no other camera sees what it sees"
        if gpu is None:
            usable = {camera: views[camera] for camera in found}
            colours = {camera: shots[camera].colours for camera in found}
            write_workspace(part / "workspace", usable, colours, found)
        say("joining the maps to a cloud")
        fused = fuse(part / "workspace", part / "fused.ply", len(found))
        clock.stage("fusion")
        reference = reference_of({camera: views[camera] for camera in found}, depths)
        results = tuple(
            _judged(dataset, shots[camera], depth, sources[camera], part) for camera, depth in found.items()
        )
        clock.stage("judging")
        model = Model(fused, 0, ())
        if options.mesh:
            say("cloud, mesh and pictures")
            centre = np.mean([views[camera].centre for camera in found], axis=0)
            model = build_model(
                part / "fused.ply", part, centre, up_of([views[camera].rotation for camera in found])
            )
            clock.stage("mesh")
        main = next(result for result in results if result.camera == reference)
        result = MultiviewResult(
            session=dataset.name,
            instant=options.instant,
            offsets_ms=options.offsets_ms,
            matcher="sweep" if gpu is None else "patchmatch",
            matcher_note=note,
            calibration=calibration,
            unit=unit,
            reference=reference,
            coverage=main.coverage,
            within_2pct=main.within_2pct,
            mover_within_2pct=main.mover_within_2pct,
            static_within_2pct=main.static_within_2pct,
            median_error_pct=main.median_error_pct,
            nearest=nearest,
            farthest=farthest,
            views=results,
            left_out=left_out,
            fused_points=fused,
            cloud_points=model.points,
            mesh_triangles=model.triangles,
            files=("fused.ply", *model.files, "workspace", RESULT),
            seconds=clock.total(),
            seconds_of=clock.seconds,
            versions=versions(),
        )
        write_whole(part / RESULT, msgspec.json.format(msgspec.json.encode(result), indent=2))
        _replace(out.absolute(), part)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return result


def _choose(matcher: Matcher) -> tuple[Gpu | None, str]:
    if matcher is Matcher.SWEEP:
        return None, "asked for"
    try:
        gpu = find_gpu()
    except NotAvailableError as error:
        if matcher is Matcher.PATCHMATCH:
            raise
        return None, error.what
    return gpu, f"on {gpu.name}"


def _guess(photos: Mapping[str, Photo]) -> Sequence[float]:
    return guessed_depths({camera: photo.view for camera, photo in photos.items()})


def _match(
    gpu: Gpu | None,
    part: Path,
    shots: Mapping[str, Shot],
    sources: Mapping[str, Sequence[str]],
    reach: tuple[float, float],
    say: Callable[[str], None],
) -> dict[str, DepthView]:
    if gpu is None:
        photos = {camera: shot.photo for camera, shot in shots.items()}
        return match_views(photos, sources, *reach, done=lambda name: say(f"depth of {name}"))
    say(f"PatchMatch on {gpu.name}")
    workspace = part / "workspace"
    usable = {camera: shots[camera] for camera in shots if sources[camera]}
    views = {camera: shot.photo.view for camera, shot in usable.items()}
    write_workspace(workspace, views, {camera: shot.colours for camera, shot in usable.items()}, reach=reach)
    run_patch_match(gpu, workspace, *reach)
    return read_maps(workspace, {camera: f"{camera}.png" for camera in usable})


def _judged(dataset: Dataset, shot: Shot, found: DepthView, sources: Sequence[str], part: Path) -> ViewResult:
    """One camera's files and, where its true depth is known, its shares."""
    name = f"depth/{shot.camera}"
    np.savez(part / f"{name}.npz", depth=found.depth, normals=found.normals.astype(np.float16))
    known = found.depth[found.depth > 0]
    near, far = np.percentile(known, [1, 99]) if known.size else (1.0, 2.0)
    cv2.imwrite(
        str(part / f"{name}.png"), colour_depth(found.depth, float(near), float(max(far, near * 1.05)))
    )
    shares: dict[str, float | None] = {}
    truth = dataset.truth(shot.camera, shot.instant)
    if truth is not None:
        depth = shot.flatten(np.where(np.isfinite(truth[0]), truth[0], 0).astype(np.float32))
        shares = judge(found.depth, depth, shot.flatten(truth[1].astype(np.uint8)) > 0)
    return ViewResult(
        camera=shot.camera,
        instant=shot.instant,
        sources=tuple(sources),
        coverage=round(float(np.mean(found.depth > 0)), 4),
        depth=f"{name}.npz",
        picture=f"{name}.png",
        **shares,
    )


def judge(depth: Array, truth: Array, movers: Array) -> dict[str, float | None]:
    """Shares of a depth map by a true one (0 = unknown) and a mask of what moves, all height x width."""
    known = truth > 0
    error = np.abs(depth - truth) / np.where(known, truth, 1)
    right = (depth > 0) & known & (error < ERROR_SHARE)
    there = (depth > 0) & known

    def share(of: Array, among: Array) -> float | None:
        return round(float(of[among].mean()), 4) if among.any() else None

    return {
        "within_2pct": share(right, known),
        "mover_within_2pct": share(right, known & movers),
        "static_within_2pct": share(right, known & ~movers),
        "mover_coverage": share(there, known & movers),
        "median_error_pct": round(100 * float(np.median(error[there])), 4) if there.any() else None,
    }


def _make_folder(part: Path) -> None:
    try:
        (part / "depth").mkdir(parents=True)
    except OSError as error:
        raise BadInputError(
            f"cannot write to {part.parent}: {error.strerror or error}", hint="choose another --out"
        ) from error


def _refuse_foreign(out: Path) -> None:
    if not out.exists():
        return
    if not out.is_dir():
        raise BadInputError(f"{out} is a file", hint="choose another --out")
    foreign = sorted(path.name for path in out.iterdir() if path.name not in OURS)
    if foreign:
        raise BadInputError(f"{out} holds other files ({foreign[0]})", hint="choose a new folder for --out")


def _replace(out: Path, part: Path) -> None:
    """Put the finished folder in its place; an earlier result there goes."""
    old = out.with_name(f".{out.name}.{os.getpid()}.old")
    if out.exists():
        out.rename(old)
    part.rename(out)
    shutil.rmtree(old, ignore_errors=True)
