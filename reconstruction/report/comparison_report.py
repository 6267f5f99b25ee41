"""The report of a comparison: one self-contained HTML page for somebody who knows nothing of cameras.

The first screen of a report: what it is of, how exact the take was, and what its motion bears.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.charts import pose_chart
from reconstruction.report.cloud_view import view_clouds
from reconstruction.report.findings import DEPTH_MEASURES, PANORAMA_MEASURES, first_known, late_or_early
from reconstruction.report.measures import (
    DEPTH,
    PANORAMA,
    TRIANGULATION,
    multiview_measures,
    pose_measures,
)
from reconstruction.report.page import Section, embed_image, render_page, write_page
from reconstruction.report.provenance import ShownPicture, files_beside, pair_pictures, provenance_entries
from reconstruction.report.tables import (
    WITH_CONTROL,
    Table,
    conditions_table,
    instants_table,
    timing_table,
    twin_table,
)
from reconstruction.report.tolerance_report import dose_heading, dose_view
from reconstruction.scores.comparison_results import CompareResult, ReportWords, WordTable
from reconstruction.scores.timing import Timing

ORIGINS = {
    "simulated": ("Simulated", "pictures and true distances are rendered"),
    "captured": ("Captured", "pictures by this rig's cameras"),
    "imported": ("Imported", "recordings made elsewhere"),
}


@dataclass(frozen=True)
class Claim:
    """One condition's number: in words, as a share 0..1 to draw, of what, and in which pictures."""

    tone: str
    value: str
    share: float
    what: str
    when: str


@dataclass(frozen=True)
class Origin:
    """Where the pictures come from: in a word, and what is of them in a line."""

    word: str
    words: str


@dataclass(frozen=True)
class Exactness:
    """This take's error beside the lateness that its motion bears, each with what it rests on."""

    error: str
    error_source: str
    bears: str
    bears_source: str
    conclusion: str


def describe_origin(result: CompareResult) -> Origin | None:
    """None where the result does not say, as of older programs."""
    if result.origin not in ORIGINS:
        return None
    word, words = ORIGINS[result.origin]
    size = f"{count(result.camera_count, 'camera')}, {count(result.instant_count, 'instant')}"
    return Origin(word, f"{size}; {words}")


def describe_exactness(result: CompareResult) -> Exactness:
    """What is known of the take's error and of its motion; what is not known is said."""
    timing, dose = result.timing, result.dose
    apart = _furthest_apart(result)
    shown = apart or timing
    error, source, measured = wording.NOT_AVAILABLE, "neither recorded nor measured", ""
    if result.unsynchronized:
        source = result.unsynchronized.partition(":")[0]
    if shown is not None and shown.late_ms is not None and shown.uncertainty_ms is not None:
        error = measured = late_or_early(shown.late_ms, shown.uncertainty_ms)
        source = f"{shown.other} against {shown.reference}, by what moves"
    if result.sync_residual_us is not None and apart is None:
        error, source = f"≤ {wording.microseconds(result.sync_residual_us)}", "by the session's own record"
        if measured:
            source += f"; {measured} by what moves"
    together = apart is None and timing is not None and timing.synchronized
    if not together:
        bears, why = wording.NOT_AVAILABLE, "the pictures were not found to be of one instant"
        if timing is None:
            why = "whether the pictures are of one instant was not measured"
    elif dose is None:
        bears, why = wording.NOT_AVAILABLE, "depth against delay was not measured"
    elif dose.tolerable_offset_ms is None:
        most = max(abs(point.offset_ms) for point in dose.points)
        bears, why = (
            f"> {wording.milliseconds(round(most))}",
            "less than a tenth of the depth is lost by then",
        )
    else:
        bears = wording.microseconds(1000 * dose.tolerable_offset_ms)
        why = "then a tenth of the depth is lost, or half of what moves is off by a pixel"
    return Exactness(error, source, bears, why, _conclude(result, together=together))


def _furthest_apart(result: CompareResult) -> Timing | None:
    """Of the cameras that were found not to be of one instant with another the one that is furthest off."""
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    known = [one for one in (result.timing, *rig) if one is not None and one.offset]
    return max(known, key=lambda one: abs(one.late_ms or 0.0), default=None)


def _conclude(result: CompareResult, *, together: bool) -> str:
    dose, error_us = result.dose, result.sync_residual_us
    if not together or dose is None or dose.tolerable_offset_ms is None or error_us is None:
        return ""
    ratio = 1000 * dose.tolerable_offset_ms / max(error_us, 1e-3)
    if ratio < 1:
        return "This take is not exact enough for this motion."
    return f"{wording.times(ratio)} more exact than this motion needs."


def claims(result: CompareResult) -> tuple[Sequence[Claim], str]:
    """Both numbers and a note on them; none where nothing was measured."""
    stereo, stitch = result.stereo, result.stitch
    depth = first_known(stereo.synced, stereo.offset, *DEPTH_MEASURES) if stereo else None
    found = first_known(stitch.synced, stitch.offset, *PANORAMA_MEASURES) if stitch else None
    note = ""
    cameras = stereo.cameras if stereo and depth else stitch.cameras if stitch else ()
    sides = wording.name_sides(result, cameras)
    if depth:
        measure, *shares = depth
        what = "of the moving surface measured correctly"
        if measure != DEPTH_MEASURES[0]:
            what = "of the moving surface given a distance"
            note = "The true distances are not known here, so this counts pixels where both pictures agree."
        shown = [wording.share(value, decimals=0) for value in shares]
    elif found and found[0] == PANORAMA_MEASURES[0]:
        _, *values = found
        what = "of misfit of moving things where the pictures of the panorama overlap"
        shares = [value / max(1e-9, *values) for value in values]
        shown = [wording.quantity(value, "px") for value in values]
    elif found:
        _, *shares = found
        what = "of moving things in both pictures where these overlap in the panorama"
        shown = [wording.share(value, decimals=0) for value in shares]
    else:
        return (), ""
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), shown, shares, whens, strict=True)
    return [Claim(tone, value, share, what, when) for tone, value, share, when in both], note


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
