"""The report of a comparison: one self-contained HTML page for somebody who knows nothing of cameras."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.charts import pose_chart
from reconstruction.report.cloud_view import view_clouds
from reconstruction.report.dose_report import dose_heading, dose_view
from reconstruction.report.embedding import embed_image
from reconstruction.report.measures import (
    DEPTH,
    PANORAMA,
    TRIANGULATION,
    multiview_measures,
    pose_measures,
)
from reconstruction.report.opening import claims, describe_exactness, describe_origin
from reconstruction.report.page import Section, render_page, write_page
from reconstruction.report.provenance import ShownPicture, files_beside, pair_pictures, provenance_entries
from reconstruction.report.tables import WITH_CONTROL, Table, conditions_table, instants_table, twin_table
from reconstruction.report.timing_table import timing_table
from reconstruction.scores.compare_results import CompareResult, ReportWords, WordTable

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
    sides = wording.name_sides(result)
    all_cameras, pair = _all_cameras(result), _tables(result)
    tables = (
        all_cameras.get("multiview_table"),
        pair["depth_table"],
        pair["points_table"],
        pair["panorama_table"],
        all_cameras.get("pose_table"),
    )
    return ReportWords(
        synced=sides.first,
        offset=sides.late,
        unsynchronized=sides.for_all_cameras().late,
        tables=tuple(_in_words(table) for table in tables if isinstance(table, Table)),
    )


def _in_words(table: Table) -> WordTable:
    return WordTable(
        caption=table.caption,
        groups=tuple(column.group for column in table.columns),
        columns=tuple(column.name for column in table.columns),
        rows=tuple((row.name, *(cell.text for cell in row.cells)) for row in table.rows),
    )


def _page(result: CompareResult, out: Path) -> str:
    name = Path(result.session).name or result.session
    sides = wording.name_sides(result)
    origin = describe_origin(result)
    clouds = result.multiview.clouds if result.multiview else None
    two_claims, claims_note = claims(result)
    hero, pictures = _first_and_others(result)
    return render_page(
        title=f"{name}: {sides.first.lower()} against {sides.late}",
        kicker=f"{sides.first} against offset",
        name=name,
        verdict=result.verdict,
        sections=_sections(result, pictures),
        opening="opening.html",
        kind=origin.word if origin else "",
        view={
            "claims": two_claims,
            "claims_note": claims_note,
            "result": result,
            "origin": origin,
            "exactness": describe_exactness(result),
            "hero": hero,
            "cloud": view_clouds(clouds, out) if clouds else None,
            "pictures": pictures,
            "sweep_sides": wording.name_sides(
                result, result.bullet_time.cameras if result.bullet_time else ()
            ),
            "image": lambda path, panels=1: embed_image(out / path, panels),
            "dose": dose_view(result.dose) if result.dose else None,
            "control": wording.control(result),
            "provenance": provenance_entries(result),
            "files": files_beside(result),
            **_all_cameras(result),
            **_tables(result),
        },
    )


def _first_and_others(result: CompareResult) -> tuple[ShownPicture | None, list[ShownPicture]]:
    """The picture of the first screen, and those further down."""
    pictures = pair_pictures(result)
    hero = next((shown for shown in pictures if shown[0].key in HEROES), None)
    return hero, [shown for shown in pictures if shown is not hero]


def _sections(result: CompareResult, pictures: Sequence[ShownPicture]) -> list[Section]:
    """The sections there is something to show in."""
    found: list[tuple[object, str, str]] = [
        (True, "why", "Why the instant matters"),
        (pictures, "pictures", "See the difference"),
        (result.bullet_time, "sweep", "From camera to camera"),
        (result.burst, "burst", "The burst"),
        (result.dose, "dose", dose_heading(result.dose) if result.dose else ""),
        (result.multiview, "all-cameras", "With all cameras at once"),
        (result.poses, "poses", "Where the cameras stand"),
        (True, "measures", "The measurements"),
        (True, "provenance", "How it was made"),
    ]
    return [
        Section(f"{anchor.replace('-', '_')}.html", anchor, title) for there, anchor, title in found if there
    ]


def _tables(result: CompareResult) -> Mapping[str, Table | str | None]:
    """The tables of the measurements, and words on them; None for a study that was not made."""
    depth = points = panorama = instants = None
    delays = ""
    if stereo := result.stereo:
        cameras = f"cameras {' and '.join(stereo.cameras)}"
        sides = wording.name_sides(result, stereo.cameras)
        depth = twin_table(f"Depth from {cameras}", DEPTH, stereo.synced, stereo.offset, sides, WITH_CONTROL)
        instants = instants_table(f"Moving things, {cameras}", stereo.per_instant, sides)
    if many := result.triangulation:
        sides = wording.name_sides(result, many.cameras)
        if len(many.cameras) > 2:
            sides = sides.for_all_cameras()
            delays = wording.describe_delays(many.offsets_ms, many.cameras[0])
        caption = f"Points by COLMAP from {count(len(many.cameras), 'camera')}"
        points = twin_table(caption, TRIANGULATION, many.synced, many.offset, sides, WITH_CONTROL)
    if stitch := result.stitch:
        caption = f"Panorama of cameras {' and '.join(stitch.cameras)}"
        sides = wording.name_sides(result, stitch.cameras)
        panorama = twin_table(caption, PANORAMA, stitch.synced, stitch.offset, sides, WITH_CONTROL)
    return {
        "depth_table": depth,
        "points_table": points,
        "points_delays": delays,
        "panorama_table": panorama,
        "timing_table": timing_table(result.rig_timing) if result.rig_timing is not None else None,
        "conditions_table": conditions_table(result),
        "instants_table": instants,
    }


def _all_cameras(result: CompareResult) -> Mapping[str, object]:
    """What the studies of all cameras show beside their pictures."""
    view: dict[str, object] = {}
    if many := result.multiview:
        caption = f"Depth from {count(len(many.cameras), 'camera')}, as {many.reference} sees it"
        sides = view["multiview_sides"] = wording.name_sides(result, many.cameras).for_all_cameras()
        view["multiview_table"] = twin_table(
            caption, multiview_measures(many), many.synced, many.offset, sides, WITH_CONTROL
        )
        view["multiview_instants"] = instants_table("Moving things, all cameras", many.per_instant, sides)
        view["multiview_delays"] = wording.describe_delays(many.offsets_ms, many.reference)
    if poses := result.poses:
        caption = f"Poses of {count(len(poses.cameras), 'camera')}, each instant by itself"
        sides = view["pose_sides"] = wording.name_sides(result, poses.cameras).for_all_cameras()
        view["pose_table"] = twin_table(caption, pose_measures(poses), poses.synced, poses.offset, sides)
        view["pose_chart"] = pose_chart(poses, sides)
        view["pose_delays"] = wording.describe_delays(poses.offsets_ms, poses.cameras[0])
    return view
