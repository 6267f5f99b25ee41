"""The report of a comparison: one self-contained HTML page for somebody who knows nothing of cameras."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.files.durable import PART, write_atomic
from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.charts import pose_chart
from reconstruction.report.claims import claims
from reconstruction.report.dose_report import dose_view
from reconstruction.report.listings import conditions_table, instants_table
from reconstruction.report.measures import DEPTH, PANORAMA, multiview_measures, pose_measures
from reconstruction.report.page import Section, render_page
from reconstruction.report.pictures import embed
from reconstruction.report.provenance import files_beside, pair_pictures, provenance_entries
from reconstruction.report.tables import WITH_CONTROL, Table, twin_table
from reconstruction.scores.compare_results import CompareResult

REPORT = "report.html"


def write_report(result: CompareResult, out: Path) -> Path:
    """Write `report.html` into the folder `out`, whole or not at all, and return its path.

    Pictures are read from `out` by the paths in the result and embedded unchanged.

    Raises:
        BadInputError: a picture is missing or is no PNG or JPEG, or the page cannot be written.
    """
    page = _page(result, out)
    target = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(target, page.encode("utf-8", "replace"))
    except OSError as error:
        with suppress(OSError):
            target.with_name(target.name + PART).unlink()
        raise BadInputError(
            f"cannot write the report {target}: {error.strerror or error}",
            hint="choose another folder with --out",
        ) from error
    return target


def _page(result: CompareResult, out: Path) -> str:
    name = Path(result.session).name or result.session
    sides = wording.name_sides(result.stereo.synced if result.stereo else None, result.actual_offset_ms)
    pictures = pair_pictures(result)
    two_claims, claims_note = claims(result, sides)
    return render_page(
        title=f"{name}: {sides.first.lower()} against {sides.late}",
        kicker=f"{sides.first} against offset",
        name=name,
        verdict=result.verdict,
        sections=_sections(result),
        claims=two_claims,
        claims_note=claims_note,
        view={
            "result": result,
            "pictures": pictures,
            "sides": sides,
            "unsynchronized": sides.for_all_cameras(),
            "image": lambda path: embed(out / path),
            "dose": dose_view(result.dose) if result.dose else None,
            "control": wording.control(result),
            "provenance": provenance_entries(result),
            "files": files_beside(result),
            **_all_cameras(result, sides.for_all_cameras()),
            **_tables(result, sides),
        },
    )


def _sections(result: CompareResult) -> list[Section]:
    """The sections there is something to show in."""
    found: list[tuple[object, str, str]] = [
        (True, "why", "Why the instant matters"),
        (pair_pictures(result), "pictures", "See the difference"),
        (result.bullet_time, "sweep", "From camera to camera"),
        (result.burst, "burst", "The burst"),
        (result.dose, "dose", "How much delay this motion tolerates"),
        (result.multiview, "all-cameras", "With all cameras at once"),
        (result.poses, "poses", "Where the cameras stand"),
        (True, "measures", "The measurements"),
        (True, "provenance", "How it was made"),
    ]
    return [
        Section(f"{anchor.replace('-', '_')}.html", anchor, title) for there, anchor, title in found if there
    ]


def _tables(result: CompareResult, sides: wording.Sides) -> Mapping[str, Table | None]:
    """The tables of the measurements; None for a study that was not made."""
    depth = panorama = instants = None
    if stereo := result.stereo:
        cameras = f"cameras {stereo.reference} and {stereo.other}"
        depth = twin_table(f"Depth from {cameras}", DEPTH, stereo.synced, stereo.offset, sides, WITH_CONTROL)
        instants = instants_table(f"Moving things, {cameras}", stereo.per_instant, sides)
    if stitch := result.stitch:
        caption = f"Panorama of cameras {' and '.join(stitch.cameras)}"
        panorama = twin_table(caption, PANORAMA, stitch.synced, stitch.offset, sides)
    return {
        "depth_table": depth,
        "panorama_table": panorama,
        "conditions_table": conditions_table(result, sides),
        "instants_table": instants,
    }


def _all_cameras(result: CompareResult, sides: wording.Sides) -> Mapping[str, object]:
    """What the studies of all cameras show beside their pictures."""
    view: dict[str, object] = {}
    if many := result.multiview:
        caption = f"Depth from {count(len(many.cameras), 'camera')}, as {many.reference} sees it"
        view["multiview_table"] = twin_table(
            caption, multiview_measures(many), many.synced, many.offset, sides, WITH_CONTROL
        )
        view["multiview_instants"] = instants_table("Moving things, all cameras", many.per_instant, sides)
        view["multiview_delays"] = wording.describe_delays(many.offsets_ms, many.reference)
    if poses := result.poses:
        caption = f"Poses of {count(len(poses.cameras), 'camera')}, each instant by itself"
        view["pose_table"] = twin_table(caption, pose_measures(poses), poses.synced, poses.offset, sides)
        view["pose_chart"] = pose_chart(poses, sides)
        view["pose_delays"] = wording.describe_delays(poses.offsets_ms, poses.cameras[0])
    return view
