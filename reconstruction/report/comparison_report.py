"""The report of a comparison: one self-contained HTML page for somebody who knows nothing of cameras."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_app.common.text import count
from reconstruction.report.charts import pose_chart
from reconstruction.report.embedding import embed_image, view_clouds
from reconstruction.report.findings import (
    UNSYNCHRONIZED,
    claims,
    describe_control,
    describe_delays,
    describe_exactness,
    describe_synchronization,
    name_sides,
)
from reconstruction.report.measures import STUDIES, describe_facts
from reconstruction.report.page import Section, render_page, write_page
from reconstruction.report.tables import conditions_table, instants_table, study_table, timing_table
from reconstruction.report.tolerance_report import tolerance_heading, tolerance_view
from reconstruction.scores.comparison_results import CompareResult, ReportWords, WordTable
from reconstruction.scores.study_result import Picture, StudyResult

ORIGINS = {
    "simulated": ("Simulated", "pictures and true distances are rendered"),
    "captured": ("Captured", "pictures by this rig's cameras"),
    "imported": ("Imported", "recordings made elsewhere"),
}
HEROES = ("stereo_depth", "panorama")
"""The picture of the first screen: where something is lost, not only elsewhere, in the late one."""


def write_report(result: CompareResult, out: Path) -> Path:
    """Write `report.html` into the folder `out`, whole or not at all, and return its path.

    Pictures are read from `out` by the paths in the result; the page holds smaller copies.

    Raises:
        BadInputError: a picture is missing or is no PNG or JPEG, or the page cannot be written.
    """
    return write_page(_page(result, out), out)


def report_words(result: CompareResult) -> ReportWords:
    """The tables of the measurements and what they call the conditions, without a page around them."""
    sides = name_sides(result)
    made = [study for study in result.studies if not study.skipped]
    tables = [study_table(study, name_sides(result, study.cameras)) for study in made]
    return ReportWords(
        synced=sides.first,
        offset=sides.late,
        unsynchronized=UNSYNCHRONIZED,
        tables=tuple(
            WordTable(
                caption=table.caption,
                groups=tuple(column.group for column in table.columns),
                columns=tuple(column.name for column in table.columns),
                rows=tuple((row.name, *(cell.text for cell in row.cells)) for row in table.rows),
            )
            for table in tables
        ),
    )


def _view(result: CompareResult, found: StudyResult) -> dict[str, Any]:
    """What a page shows of a study; without tables where it was skipped."""
    text, sides, made = STUDIES[found.name], name_sides(result, found.cameras), not found.skipped
    many = "all cameras" if len(found.cameras) > 2 else f"cameras {' and '.join(found.cameras)}"
    return {
        "found": found,
        "text": text,
        "sides": sides,
        "delays": describe_delays(found) if made else "",
        "engine": text.engine.format(**describe_facts(found)) if made else "",
        "table": study_table(found, sides) if made else None,
        "instants": instants_table(f"Moving things, {many}", found, sides) if made else None,
    }


def _page(result: CompareResult, out: Path) -> str:
    name = Path(result.session).name or result.session
    sides, sweep = name_sides(result), result.bullet_time
    views = {study.name: _view(result, study) for study in result.studies}
    multiview, poses = result.study("multiview"), result.study("poses")
    clouds = multiview.facts.get("clouds") if multiview is not None else None
    word, words = ORIGINS.get(result.origin, ("", ""))
    size = f"{count(result.camera_count, 'camera')}, {count(result.instant_count, 'instant')}"
    two_claims, claims_note = claims(result)
    pictures = _pair_pictures(views)
    hero = next((shown for shown in pictures if shown[0].key in HEROES), None)
    view = {
        "title": f"{name}: {sides.first.lower()} against {sides.late}",
        "kicker": f"{sides.first} against offset",
        "name": name,
        "verdict": result.verdict,
        "opening": "opening.html",
        "kind": word,
        "claims": two_claims,
        "claims_note": claims_note,
        "result": result,
        "origin": f"{size}; {words}" if word else "",
        "exactness": describe_exactness(result),
        "hero": hero,
        "views": views,
        "cloud": view_clouds(clouds, out, str(multiview.facts["reference"]), len(multiview.cameras))
        if multiview is not None and clouds
        else None,
        "pictures": [shown for shown in pictures if shown is not hero],
        "sweep_sides": name_sides(result, sweep.cameras if sweep else ()),
        "image": lambda path, panels=1: embed_image(out / path, panels),
        "tolerance": tolerance_view(result.tolerance) if result.tolerance else None,
        "control": describe_control(result),
        "synchronization": describe_synchronization(result),
        "pose_chart": pose_chart(poses, views["poses"]["sides"]) if poses is not None else None,
        "timing_table": timing_table(result.rig_timing) if result.rig_timing is not None else None,
        "conditions_table": conditions_table(result),
    }
    return render_page(view, _sections(result, len(pictures) > (hero is not None)))


def _pair_pictures(views: Mapping[str, dict[str, Any]]) -> list[tuple[Picture, dict[str, Any]]]:
    """The pictures that compare a pair; those with a slider come first, they show the difference at once."""
    found = [
        (picture, view)
        for view in views.values()
        if len(view["found"].cameras) == 2
        for picture in view["found"].pictures
    ]
    return sorted(found, key=lambda one: one[0].panels > 1)


def _sections(result: CompareResult, pictures: bool) -> list[Section]:
    """The sections there is something to show in."""
    found: list[tuple[object, str, str]] = [
        (True, "why", "Why the instant matters"),
        (pictures, "pictures", "See the difference"),
        (result.bullet_time, "sweep", "From camera to camera"),
        (result.burst, "burst", "The burst"),
        (result.tolerance, "tolerance", tolerance_heading(result.tolerance) if result.tolerance else ""),
        (result.study("multiview"), "all-cameras", "With all cameras at once"),
        (result.study("poses"), "poses", "Where the cameras stand"),
        (True, "measures", "The measurements"),
        (True, "provenance", "How it was made"),
    ]
    return [
        Section(f"{anchor.replace('-', '_')}.html", anchor, title) for there, anchor, title in found if there
    ]
