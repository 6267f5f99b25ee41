"""The report of a comparison: one self-contained HTML page for somebody who knows nothing of cameras."""

from contextlib import suppress
from html import escape
from importlib.resources import files
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.files.durable import PART, write_whole
from reconstruction.report import wording
from reconstruction.report.all_cameras import all_cameras_section
from reconstruction.report.bullet_time import bullet_time_section
from reconstruction.report.burst import burst_section
from reconstruction.report.claims import claims
from reconstruction.report.conditions import conditions_table, instants_table
from reconstruction.report.dose import dose_section
from reconstruction.report.frame import fill_page
from reconstruction.report.making import making_section
from reconstruction.report.pictures import pictures_section
from reconstruction.report.poses import poses_section
from reconstruction.report.tables import depth_table, panorama_table
from reconstruction.scores.compare_results import CompareResult

REPORT = "report.html"


def write_report(result: CompareResult, out: Path) -> Path:
    """Write `report.html` into the folder `out`, whole or not at all, and return its path.

    Pictures are read from `out` by the paths in `result.pictures` and embedded unchanged. Raises
    BadInputError where a picture is missing or is no PNG or JPEG, or where the page cannot be written.
    """
    page = _page(result, out)
    target = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_whole(target, page.encode("utf-8", "replace"))
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
    sides = _sides(result)
    sections = [
        _why(result),
        pictures_section(result.pictures, out, sides),
        bullet_time_section(result.bullet_time, out, sides),
        burst_section(result.burst, out),
        dose_section(result.dose),
        all_cameras_section(result.multiview, out, sides),
        poses_section(result.poses, sides),
        _measures(result),
        making_section(result),
    ]
    return fill_page(
        title=f"{name}: {sides.first.lower()} against {sides.late}",
        kicker=f"{sides.first} against offset",
        name=name,
        verdict=result.verdict,
        claims=claims(result),
        sections=sections,
    )


def _sides(result: CompareResult) -> wording.Sides:
    return wording.sides(result.stereo.synced if result.stereo else None, result.actual_offset_ms)


def _why(result: CompareResult) -> str:
    depth = """
<p>Two cameras see the world from two places, as two eyes do. The further a thing shifts from one picture to
the other, the nearer it is: that shift is how distance is measured, point by point.</p>
<p>A camera that fires late spoils this. Meanwhile a moving thing has moved by itself, and nothing in the
pictures tells the one shift from the other: its distance comes out wrong, or not at all. Things at rest
come out right either way."""
    panorama = """
<p>A panorama joins pictures where they overlap. What moves between one picture and the next no longer fits
there: it shows up twice, cut apart, or in the wrong place."""
    words = panorama if result.stitch and not result.stereo else depth
    folder = files("reconstruction.report") / "template"
    diagram = (folder / "diagram.svg").read_text("utf-8") if words is depth else ""
    walk = escape(wording.walk(result.actual_offset_ms))
    return f"""<section class="why" aria-labelledby="why">
<div><h2 id="why">Why the instant matters</h2>{words} {walk}</p></div>
{diagram}</section>"""


def _measures(result: CompareResult) -> str:
    sides = _sides(result)
    parts = [
        depth_table(result.stereo, sides)
        if result.stereo
        else _skipped("Depth was not measured", result.stereo_skipped),
        panorama_table(result.stitch, sides)
        if result.stitch
        else _skipped("No panorama was made", result.stitch_skipped),
        conditions_table(result),
        instants_table(result.stereo, sides) if result.stereo else "",
    ]
    fair = "The same cameras, the same calibration, the same method: only the instant of one picture differs."
    words = f"<p>{fair} {escape(wording.control(result))}</p>" if result.stereo or result.stitch else ""
    return f"""<section aria-labelledby="measures">
<h2 id="measures">The measurements</h2>
{words}
{"".join(parts)}
</section>"""


def _skipped(what: str, why: str) -> str:
    reason = f": {escape(wording.tie(why))}" if why else ""
    return f'<p class="note"><b>{what}</b>{reason}.</p>'
