"""How a comparison was made: cameras, offset, calibration, software, and the path of every file."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.study_result import Picture

ShownPicture = tuple[Picture, wording.Sides]
"""A picture, and what its two sides are called."""


@dataclass(frozen=True)
class Entry:
    """A term and its description; a `path` is set as code."""

    term: str
    words: str
    path: bool = False


@dataclass(frozen=True)
class Files:
    """Files beside the page, and what they show."""

    what: str
    paths: Sequence[str]


def provenance_entries(result: CompareResult) -> list[Entry]:
    """What decides the numbers, and the software."""
    entries = [Entry("Session", result.session, path=True)]
    if stereo := result.stereo:
        entries.append(Entry("Depth", _pair(stereo.cameras, stereo.synced.instants, stereo.reason)))
    if stitch := result.stitch:
        entries.append(Entry("Panorama", _pair(stitch.cameras, stitch.synced.instants, stitch.reason)))
    if many := result.multiview:
        width = f", pictures {many.width_px} px wide" if many.width_px else ""
        instants = count(many.synced.instants, "instant")
        by = ", matched by COLMAP's PatchMatch" if many.matcher == "patchmatch" else ""
        entries.append(Entry("All cameras", f"{', '.join(many.cameras)}, {instants}{width}{by}"))
    elif result.multiview_skipped:
        entries.append(Entry("All cameras", f"not measured: {result.multiview_skipped}"))
    if result.poses_skipped:
        entries.append(Entry("Poses by instant", f"not measured: {result.poses_skipped}"))
    asked, actual = (wording.milliseconds(ms) for ms in (result.offset_ms, result.actual_offset_ms))
    if result.time_shifts_ms:
        shifts = (f"{name} {ms:+g}{wording.GAP}ms" for name, ms in result.time_shifts_ms.items())
        entries.append(Entry("Times corrected", ", ".join(shifts)))
    frames = count(result.offset_frames, "frame")
    recorded = wording.synchronization(result.sync_residual_us, result.sync_bound_us)
    sync = result.unsynchronized or recorded
    entries += [
        Entry("Offset", f"{asked} asked for; {actual} given, which is {frames}"),
        Entry("Calibration", result.calibration),
        Entry("Synchronization", sync),
        Entry("Time taken", wording.seconds(result.seconds)),
    ]
    if result.versions:
        versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
        entries.append(Entry("Software", versions))
    return entries


def _pair(cameras: Sequence[str], instants: int, reason: str) -> str:
    words = f"cameras {' and '.join(cameras)}, {count(instants, 'instant')}"
    return f"{words} (selection: {reason})" if reason else words


def pair_pictures(result: CompareResult) -> list[ShownPicture]:
    """The pictures that compare a pair, and what their sides are called.

    Those with a slider come first, they show the difference at once.
    """
    found = []
    for study in (result.stereo, result.stitch):
        if study is not None:
            sides = wording.name_sides(result, study.cameras)
            found += [(picture, sides) for picture in study.pictures]
    return sorted(found, key=lambda one: one[0].panels > 1)


def files_beside(result: CompareResult) -> list[Files]:
    """Every file of the folder that the page lies in."""
    found = [Files("all numbers, for programs", ["metrics.json"])]
    found += [
        Files(f"{one.title}: {sides.first.lower()}, offset", [one.synced, one.offset])
        for one, sides in pair_pictures(result)
    ]
    if many := result.multiview:
        found += [
            Files(f"{one.title}: {wording.UNSYNCHRONIZED}", [one.synced, one.offset]) for one in many.pictures
        ]
        if many.clouds:
            found.append(Files("the cloud of one instant in both", [many.clouds.synced, many.clouds.offset]))
    if sweep := result.bullet_time:
        found.append(Files("from camera to camera, to share", [sweep.file]))
        found.append(Files("the same, picture by picture", [*sweep.synced, *sweep.offset]))
    if burst := result.burst:
        found.append(Files("the burst", [path for row in burst.thumbnails for path in row if path]))
    found.append(Files("intermediate results, reused by the next run; may be deleted", ["stages/"]))
    return found
