"""Report of a comparison: one self-contained HTML page for a reader who knows nothing about cameras."""

from collections.abc import Mapping, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from capture_app.common.text import count
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.phrases import LIMITS, UNSYNCHRONIZED
from reconstruction.method.score import reported, say_all, study_reports
from reconstruction.method.study_result import StudyResult
from reconstruction.pages.embedding import embed_image
from reconstruction.pages.page import Section, as_template, render_page, write_page
from reconstruction.report.findings import (
    claims,
    describe_delays,
    exactness_view,
    name_conditions,
)
from reconstruction.report.report_tables import conditions_table, instants_table, study_table, timing_table
from reconstruction.report.tolerance_report import tolerance_heading, tolerance_view

ORIGINS = {
    "simulated": ("Simulated", "pictures and true distances are rendered"),
    "captured": ("Captured", "pictures by this rig's cameras"),
    "imported": ("Imported", "recordings made elsewhere"),
}


def write_report(result: CompareResult, out: Path, running: Sequence[str] = ()) -> Path:
    """Write `report.html` atomically into the folder `out` and return its path.

    Pictures are read from `out` by the paths in the result; the page contains smaller copies. `running`: the
    subjects that are still being measured. The page names them, and loads itself again until there are none.

    Raises:
        BadInputError: a picture is missing or is neither PNG nor JPEG, or the page cannot be written.
    """
    return write_page(say_all(result, partial(_page, out=out, running=running)), out)


def report_words(result: CompareResult) -> dict[str, Any]:
    """Return the tables of measurements and the names of the conditions, without a page around them.

    `synced` is "Synchronized", or "As recorded" if the images cannot be of one instant. `offset` is a name
    such as "67 ms late". `unsynchronized` names the other condition of studies of all cameras.

    Each of the `tables` has the subject of each column in `groups` (moving things or the control; empty if it
    covers both) and its condition in `columns`. A row is the measure's name, then a value with its unit for
    each column.
    """
    names = name_conditions(result)
    tables = [
        study_table(made, name_conditions(result, made.cameras))
        for study, made in reported(result)
        if study.text.measures
    ]
    return {
        "synced": names.first,
        "offset": names.late,
        "unsynchronized": UNSYNCHRONIZED,
        "tables": [
            {
                "caption": table.caption,
                "groups": [column.group for column in table.columns],
                "columns": [column.name for column in table.columns],
                "rows": [(row.name, *(cell.text for cell in row.cells)) for row in table.rows],
            }
            for table in tables
        ],
    }


def _view(result: CompareResult, found: StudyResult[Any], out: Path) -> dict[str, Any]:
    """Return what the page shows of a study; a skipped study has no tables."""
    study, names, made = (
        study_reports()[found.name],
        name_conditions(result, found.cameras),
        not found.skipped,
    )
    text, placeholders = study.text, study.placeholders(found) if made else {}
    many = "all cameras" if len(found.cameras) > 2 else f"cameras {' and '.join(found.cameras)}"
    view = {
        "found": found,
        "text": text,
        "conditions": names,
        "delays": describe_delays(found) if made and text.measures else "",
        "engine": text.engine.format(**placeholders) if made else "",
        "details": text.details.format(**placeholders) if made else "",
        "files": study.files(found) if made else {},
        "table": study_table(found, names) if made else None,
        "instants": instants_table(f"Moving things, {many}", found, names) if made else None,
    }
    return view | (
        study.view(found, {"synced": names.first, "offset": names.late}, out) if made and text.section else {}
    )


def _page(result: CompareResult, out: Path, running: Sequence[str]) -> str:
    name = Path(result.session).name or result.session
    names, made = name_conditions(result), reported(result)
    views = {study.name: _view(result, study, out) for study in result.studies}
    kind, meaning = ORIGINS.get(result.origin, ("", ""))
    size = f"{count(result.camera_count, 'camera')}, {count(result.instant_count, 'instant')}"
    two_claims, claims_note = claims(result)
    pictures = [
        (picture, view)
        for view in views.values()
        if not view["text"].section
        for picture in view["found"].pictures
    ]
    # Those with a slider come first.
    pictures.sort(key=lambda shown: shown[0].panels > 1)
    hero = next((shown for shown in pictures if shown[0].key == shown[1]["text"].hero), None)
    texts = [study.text for study in (*(study for study, _ in made), *study_reports().values())]
    reason = next((text for text in texts if text.why), None)
    view = {
        "title": f"{name}: {names.first.lower()} against {names.late}",
        "kicker": f"{names.first} against offset",
        "name": name,
        "verdict": result.verdict,
        "opening": "opening.html",
        "running": running,
        "failed": [
            (study_reports()[study.name].text.subject, study.skipped)
            for study in result.studies
            if study.failed
        ],
        "kind": kind,
        "claims": two_claims,
        "claims_note": claims_note,
        "result": result,
        "origin": f"{size}; {meaning}" if kind else "",
        **exactness_view(result),
        **LIMITS,
        "hero": hero,
        "why": as_template(reason.why if reason else ""),
        "diagram": reason.diagram if reason else "",
        "views": views,
        "scripts": list(dict.fromkeys(script for study, _ in made for script in study.text.scripts)),
        "pictures": [shown for shown in pictures if shown is not hero],
        "image": lambda path, panels=1: embed_image(out / path, panels),
        "tolerance": tolerance_view(result.tolerance) if result.tolerance else None,
        "pairs": any(study.text.measures and len(result_of.cameras) == 2 for study, result_of in made),
        "control": next(
            filter(None, (study.control_sentence(result, result_of) for study, result_of in made)), ""
        ),
        "timing_table": timing_table(result.rig_timing) if result.rig_timing is not None else None,
        "conditions_table": conditions_table(result),
    }
    return render_page(view, _sections(result, views, len(pictures) > (hero is not None)))


def _sections(result: CompareResult, views: Mapping[str, dict[str, Any]], pictures: bool) -> list[Section]:
    """Return the sections that have content, in page order."""
    sections = [
        (0, Section("why.html", "why", "Why the instant matters")),
        (80, Section("measures.html", "measures", "The measurements")),
        (90, Section("provenance.html", "provenance", "How it was made")),
    ]
    if pictures:
        sections.append((10, Section("pictures.html", "pictures", "See the difference")))
    if result.tolerance:
        sections.append((40, Section("tolerance.html", "tolerance", tolerance_heading(result.tolerance))))
    sections += [
        (
            text.section_place,
            Section(as_template(text.section), text.name.replace("_", "-"), text.title, views[text.name]),
        )
        for text in (study.text for study, _ in reported(result) if study.text.section)
    ]
    return [section for _, section in sorted(sections, key=itemgetter(0))]
