"""Results for display, read from the JSON files that the commands write; nothing is computed here."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.session.format.manifest import inside
from capture_app.tui.jobs.run import (
    CLOUDS,
    COMPARE,
    MOMENT,
    MULTIVIEW,
    PANEL,
    PANORAMA,
    TOLERANCE,
    Run,
)
from capture_app.tui.widgets.lines import filled_cells

SYNCED, LATE = "same instant", "late"
BAR = 20
"""Cells of a bar at 100 %."""
_FIRST = ("multiview_depth", "stereo_depth", "panorama", "multiview_movers", "stereo_movers", "stereo_late")
"""Most informative pictures, shown first."""
_STUDIES = {
    "stereo": "depth of a pair",
    "triangulation": "points by COLMAP",
    "multiview": "depth from all cameras",
    "panorama": "panorama",
}


@dataclass(frozen=True, slots=True)
class ResultPicture:
    """Picture in both conditions; `offset` is None if only the synchronized one exists."""

    title: str
    caption: str
    synced: Path
    offset: Path | None
    synced_words: str = SYNCED
    offset_words: str = LATE


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Table of formatted values: headings of the value columns, and rows that start with a name."""

    caption: str
    groups: tuple[str, ...]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class StudyResult:
    """Content of a run's result as the screen shows it."""

    verdict: str
    pictures: tuple[ResultPicture, ...] = ()
    tables: tuple[ResultTable, ...] = ()
    remarks: tuple[str, ...] = ()
    """Notes on what was not measured, with the reason."""


def percent(share: float | None) -> str:
    """Format a fraction in percent, or a dash for None; never rounded up to 100 % or down to 0 %."""
    if share is None:
        return "–"
    if 0.99 < share < 1:
        return f"{int(1000 * share) / 10:.1f} %"
    return f"{100 * share:.1f} %" if 0 < share < 0.1 else f"{100 * share:.0f} %"


def read_result(run: Run) -> StudyResult:
    """Read a run's result. Raises BadInputError if it is missing or unreadable."""
    path = run.result
    if path is None or run.out is None:
        raise BadInputError(f"{run.command.title} of {run.session.name} has no result", hint="run it again")
    try:
        found = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        return _READERS[run.kind](found, run.out, run.message)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}", hint="run it again") from error
    except (msgspec.DecodeError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise BadInputError(f"{path} is not as this version writes it", hint="run it again") from error


def _comparison(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    words = found.get("words") or {}
    pictures = {}
    for study in found["studies"]:
        offset = words.get("unsynchronized" if len(study["cameras"]) > 2 else "offset", LATE)
        for one in study["pictures"]:
            pictures[one["key"]] = ResultPicture(
                one["title"],
                one["caption"],
                inside(folder, one["synced"]),
                inside(folder, one["offset"]),
                words.get("synced", SYNCED).lower(),
                offset,
            )
    order = sorted(pictures, key=lambda key: _FIRST.index(key) if key in _FIRST else len(_FIRST))
    skipped = [
        f"no {_STUDIES[study['name']]}: {study['skipped']}"
        for study in found["studies"]
        if study["skipped"] and study["name"] in _STUDIES
    ]
    return StudyResult(
        verdict,
        tuple(pictures[key] for key in order),
        msgspec.convert(words.get("tables", ()), tuple[ResultTable, ...]),
        tuple(skipped),
    )


def _panorama(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    synced, late = found["synced"], found.get("offset")
    late_words = f"every second camera {found['actual_offset_ms']:.0f} ms late"

    def picture(key: str, title: str, caption: str) -> ResultPicture:
        other = None if late is None else inside(folder, late[key])
        return ResultPicture(title, caption, inside(folder, synced[key]), other, SYNCED, late_words)

    # Whether the residual of moving objects is known.
    moving = (synced.get("mover_misfit") or {}).get("median_px") is not None
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
    measure, (first, second) = found["measure"], found["cameras"]
    still = measure.replace("mover_", "static_")
    rows = tuple(
        (
            _delay_text(point["offsets_ms"][second]),
            percent(_value(point, measure)),
            filled_cells(_value(point, measure) or 0.0, BAR),
            percent(_value(point, still)),
        )
        for point in found["points"]
    )
    what = "right to within 2 %" if measure.endswith("2pct") else "given a distance"
    return StudyResult(
        verdict,
        (),
        (
            ResultTable(
                f"Depth from {first} and {second}: {what}",
                ("", "", ""),
                ("what moves", "", "what stands still"),
                rows,
            ),
        ),
    )


def _value(point: Mapping[str, Any], measure: str) -> float | None:
    found = next((one["offset"] for one in point["measures"] if one["name"] == measure), None)
    return found and float(found["value"])


def _panel(found: Mapping[str, Any], folder: Path, verdict: str) -> StudyResult:
    return msgspec.convert(found["words"], StudyResult)


_READERS = {
    COMPARE.name: _comparison,
    PANORAMA.name: _panorama,
    MULTIVIEW.name: _multiview,
    MOMENT.name: _multiview,
    CLOUDS.name: _clouds,
    TOLERANCE.name: _dose,
    PANEL.name: _panel,
}


def _delay_text(offset_ms: float) -> str:
    if not offset_ms:
        return "same instant"
    return f"{abs(offset_ms):.0f} ms {'early' if offset_ms < 0 else 'late'}"
