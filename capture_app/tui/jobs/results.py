"""Results as a screen shows them, read from the files that `reconstruct` has written: nothing is computed."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from capture_app.errors import BadInputError
from capture_app.session.format.checks import inside
from capture_app.text import count
from capture_app.tui.drawing.line_parts import filled_cells
from capture_app.tui.jobs.job import Job
from capture_app.tui.jobs.kinds import CLOUDS, COMPARE, DOSE, MULTIVIEW, PANEL, STITCH
from capture_app.tui.jobs.outcome import moves, outcome, percent
from capture_app.tui.jobs.panel_result import panel_remarks, panel_tables

SYNCED, LATE = "same instant", "late"
BAR = 20
"""Cells of a share of 100 %."""
_FIRST = ("multiview_depth", "stereo_depth", "panorama", "multiview_movers", "stereo_movers", "stereo_late")
"""The pictures that tell most come first."""
_STUDIES = {
    "stereo": "depth of a pair",
    "triangulation": "points by COLMAP",
    "multiview": "depth from all cameras",
    "stitch": "panorama",
}


@dataclass(frozen=True, slots=True)
class ResultPicture:
    """A picture of both conditions; `offset` is None where there is the synchronized one only."""

    title: str
    caption: str
    synced: Path
    offset: Path | None
    synced_words: str = SYNCED
    offset_words: str = LATE


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Figures in words: a heading for each column of values, and rows that begin with a name."""

    caption: str
    groups: tuple[str, ...]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class StudyResult:
    """All that a screen shows of a job's result."""

    verdict: str
    pictures: tuple[ResultPicture, ...] = ()
    tables: tuple[ResultTable, ...] = ()
    remarks: tuple[str, ...] = ()
    """What was not measured, and why."""
    report: Path | None = None


def read_result(job: Job) -> StudyResult:
    """Read what a job has found. Raises BadInputError where it is gone or cannot be read."""
    path = job.result
    if path is None or job.out is None:
        raise BadInputError(f"{job.kind.title} of {job.session.name} has no result", hint="run it again")
    try:
        data = path.read_bytes()
        found = msgspec.json.decode(data, type=dict[str, Any])
        result = _READERS[job.kind.name](found, job.out, outcome(job.kind, data))
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}", hint="run it again") from error
    except (msgspec.DecodeError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise BadInputError(f"{path} is not as this version writes it", hint="run it again") from error
    return result


def _comparison(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    words = found.get("words") or {}
    pictures = {}
    for study in ("multiview", "stereo", "stitch"):
        offset = words.get("unsynchronized" if study == "multiview" else "offset", LATE)
        for one in (found.get(study) or {}).get("pictures", ()):
            pictures[one["key"]] = ResultPicture(
                one["title"],
                one["caption"],
                inside(folder, one["synced"]),
                inside(folder, one["offset"]),
                words.get("synced", SYNCED).lower(),
                offset,
            )
    order = [key for key in _FIRST if key in pictures]
    order += [key for key in pictures if key not in order]
    skipped = [
        f"no {what}: {found[f'{study}_skipped']}"
        for study, what in _STUDIES.items()
        if found.get(f"{study}_skipped")
    ]
    return StudyResult(
        verdict,
        tuple(pictures[key] for key in order),
        tuple(
            ResultTable(
                table["caption"],
                tuple(table["groups"]),
                tuple(table["columns"]),
                tuple(tuple(row) for row in table["rows"]),
            )
            for table in words.get("tables", ())
        ),
        tuple(skipped),
        _report(found, folder),
    )


def _panorama(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    synced, late = found["synced"], found.get("offset")
    late_words = f"every second camera {found['actual_offset_ms']:.0f} ms late"

    def picture(key: str, title: str, caption: str) -> ResultPicture:
        other = None if late is None else inside(folder, late[key])
        return ResultPicture(title, caption, inside(folder, synced[key]), other, SYNCED, late_words)

    moving = moves(found)
    overlaps = {(o["first"], o["second"]): _misfit(o, moving) for o in (late or {}).get("overlaps", ())}
    rows = tuple(
        (
            f"{one['first']} and {one['second']}",
            _misfit(one, moving),
            *([overlaps[pair]] if (pair := (one["first"], one["second"])) in overlaps else []),
        )
        for one in synced["overlaps"]
    )
    what = "Misfit of what moves where pictures overlap" if moving else "Misfit where pictures overlap"
    columns = ("same instant", f"{found['actual_offset_ms']:.0f} ms late") if late else ("same instant",)
    return StudyResult(
        verdict,
        (
            picture("panorama", "Panorama", f"From {count(len(found['used']), 'picture')} of one instant."),
            picture("ghosts", "Ghosts", "The same; where pictures do not fit together it is marked."),
        ),
        (ResultTable(what, ("",) * len(columns), columns, rows),),
        tuple(f"{name} is left out: {why}" for name, why in found["left_out"].items()),
    )


def _misfit(overlap: Mapping[str, Any], moving: bool) -> str:
    found = overlap["mover_misfit" if moving else "misfit"]
    return "–" if found is None or found["median_px"] is None else f"{found['median_px']:.1f} px"


def _multiview(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    views = found["views"]
    rows = tuple(
        (view["camera"], percent(view["coverage"]), percent(view.get("within_2pct"))) for view in views
    )
    return StudyResult(
        verdict,
        tuple(
            ResultPicture(
                f"Distance, {view['camera']}",
                f"Bright is near, blue is far; dark means that no distance was found. "
                f"{found['nearest']:.3g} to {found['farthest']:.3g} {found['unit']}.",
                inside(folder, view["picture"]),
                None,
            )
            for view in views
        ),
        (ResultTable("Depth maps", ("", ""), ("given a distance", "within 2 % of the truth"), rows),),
        (
            *(f"{name} is left out: {why}" for name, why in found["left_out"].items()),
            *(f"file: {folder / name}" for name in found["files"] if name.endswith(".ply")),
        ),
    )


def _clouds(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    every = found["instants"]
    without = [one for one in every if not one.get("cloud")]
    rows = tuple(
        (str(one["instant"]), f"{one['points']:,}", percent(one.get("mover_within_2pct")))
        for one in every
        if one.get("cloud")
    )
    columns = ("points", "what moves, within 2 % of the truth")
    return StudyResult(
        verdict,
        (),
        (ResultTable("Clouds by instant", ("", ""), columns, rows),),
        (
            *(f"instant {one['instant']} has no cloud: {one['reason']}" for one in without),
            *(f"in {folder}: {name}" for name in found["files"] if name in ("clouds", "movers")),
        ),
    )


def _dose(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    measure = found["measure"]
    still = measure.replace("mover_", "static_")
    rows = tuple(
        (
            _lateness(point["offset_ms"]),
            percent(point["scores"][measure]),
            filled_cells(point["scores"][measure] or 0.0, BAR),
            percent(point["scores"][still]),
        )
        for point in found["points"]
    )
    what = "right to within 2 %" if measure.endswith("2pct") else "given a distance"
    return StudyResult(
        verdict,
        (),
        (
            ResultTable(
                f"Depth from {found['reference']} and {found['other']}: {what}",
                ("", "", ""),
                ("what moves", "", "what stands still"),
                rows,
            ),
        ),
        (),
        _report(found, folder),
    )


def _panel(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    tables = tuple(ResultTable(*table) for table in panel_tables(found))
    return StudyResult(verdict, (), tables, panel_remarks(found))


_READERS = {
    COMPARE.name: _comparison,
    STITCH.name: _panorama,
    MULTIVIEW.name: _multiview,
    CLOUDS.name: _clouds,
    DOSE.name: _dose,
    PANEL.name: _panel,
}


def _report(found: Mapping[str, Any], folder: Path) -> Path | None:
    return inside(folder, found["report"]) if found.get("report") else None


def _lateness(offset_ms: float) -> str:
    if not offset_ms:
        return "same instant"
    return f"{abs(offset_ms):.0f} ms {'early' if offset_ms < 0 else 'late'}"
