"""How a comparison was made: cameras, offset, calibration, software, and the path of every file."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.findings import UNSYNCHRONIZED, Sides, describe_synchronization, name_sides
from reconstruction.report.measures import STUDIES
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.study_result import Picture, StudyResult

ShownPicture = tuple[Picture, Sides]
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
    entries += [Entry(STUDIES[one.name].term, _describe(one)) for one in result.studies]
    asked, actual = (wording.milliseconds(ms) for ms in (result.offset_ms, result.actual_offset_ms))
    if result.time_shifts_ms:
        shifts = (f"{name} {ms:+g}{wording.GAP}ms" for name, ms in result.time_shifts_ms.items())
        entries.append(Entry("Times corrected", ", ".join(shifts)))
    frames = count(result.offset_frames, "frame")
    entries += [
        Entry("Offset", f"{asked} asked for; {actual} given, which is {frames}"),
        Entry("Calibration", result.calibration),
        Entry("Synchronization", describe_synchronization(result)),
        Entry("Time taken", wording.seconds(result.seconds)),
    ]
    if result.versions:
        versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
        entries.append(Entry("Software", versions))
    return entries


def _describe(study: StudyResult) -> str:
    if study.skipped:
        return f"not measured: {study.skipped}"
    names = f"cameras {' and '.join(study.cameras)}" if len(study.cameras) == 2 else ", ".join(study.cameras)
    words = f"{names}, {count(study.instants, 'instant')}"
    if width := study.facts.get("width_px"):
        words += f", pictures {width} px wide"
    if study.facts.get("matcher") == "patchmatch":
        words += ", matched by COLMAP's PatchMatch"
    return f"{words} (selection: {study.reason})" if study.reason else words


def pair_pictures(result: CompareResult) -> list[ShownPicture]:
    """The pictures that compare a pair, and what their sides are called.

    Those with a slider come first, they show the difference at once.
    """
    found = []
    for study in (result.study("stereo"), result.study("panorama")):
        if study is not None:
            sides = name_sides(result, study.cameras)
            found += [(picture, sides) for picture in study.pictures]
    return sorted(found, key=lambda one: one[0].panels > 1)


def files_beside(result: CompareResult) -> list[Files]:
    """Every file of the folder that the page lies in."""
    found = [Files("all numbers, for programs", ["metrics.json"])]
    found += [
        Files(f"{one.title}: {sides.first.lower()}, offset", [one.synced, one.offset])
        for one, sides in pair_pictures(result)
    ]
    if many := result.study("multiview"):
        found += [Files(f"{one.title}: {UNSYNCHRONIZED}", [one.synced, one.offset]) for one in many.pictures]
        if clouds := many.facts.get("clouds"):
            found.append(Files("the cloud of one instant in both", [clouds.synced, clouds.offset]))
    if sweep := result.bullet_time:
        found.append(Files("from camera to camera, to share", [sweep.file]))
        found.append(Files("from camera to camera, picture by picture", [*sweep.synced, *sweep.offset]))
    if burst := result.burst:
        found.append(Files("the burst", [path for row in burst.thumbnails for path in row if path]))
    found.append(Files("intermediate results, reused by the next run; may be deleted", ["stages/"]))
    return found
