"""The tables and numbers of a report, honest about what was not measured."""

import re
from typing import Any

import msgspec

from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult, ConditionResult
from reconstruction.methods.stereo.stereo_study import StereoStudy
from reconstruction.report.comparison_report import report_words
from tests.unit.reconstruction.report.conftest import ReadReport
from tests.unit.reconstruction.report.results import (
    PANORAMA,
    RESULT,
    STEREO,
    TIMING,
    changed,
    found,
    skipped,
    with_studies,
)

LOST = {
    "mover_within_2pct": 0.005,
    "static_within_2pct": 0.673,
    "mover_epipolar_px": 9.8,
    "static_epipolar_px": 0.05,
}


def test_movers_stand_beside_the_static_control(read_report: ReadReport) -> None:
    page = read_report()
    row = page.text[page.text.index("Given a distance") :]
    assert re.match(r".*?99\.9 %\D*40\.5 %\D*74\.5 %\D*73\.3 %", row)
    assert "comes from timing alone" in page.text
    row = page.text[page.text.index("Vertical mismatch") :]
    assert re.match(r".*?0\.26 px\s*17\.7 px\s*n/a\s*n/a", row)
    assert "Brightness mismatch" not in page.text
    assert "more strictly" not in page.text


def test_stricter_and_laxer_shares_are_told_where_they_were_taken(read_report: ReadReport) -> None:
    both = {"mover_within_1pct": 0.905, "mover_within_5pct": 0.993}
    page = read_report(RESULT, changed(STEREO, both))
    assert re.match(r".*more strictly.*?90\.5 %\s*n/a.*less strictly.*?99\.3 %\s*n/a", page.text)


def test_a_control_that_moves_is_admitted(read_report: ReadReport) -> None:
    page = read_report(RESULT, changed(STEREO, offset={"static_within_2pct": 0.6}))
    assert "comes from timing alone" not in page.text
    assert "not all of the difference comes from timing" in page.text


def test_what_stands_still_is_a_control_only_of_cameras_at_rest(whole: CompareResult) -> None:
    stereo = changed(
        found(whole, "stereo"),
        {"mover_within_2pct": 0.98, "static_coverage": 0.745},
        {"mover_within_2pct": 0.01, "static_coverage": 0.74},
    )
    assert "timing alone makes the difference" in StereoStudy.verdict(whole, stereo)
    moved = msgspec.structs.replace(
        whole, timing=msgspec.structs.replace(TIMING, moving_cameras={"cam2": 3.0})
    )
    assert "timing alone" not in StereoStudy.verdict(moved, stereo)
    less = changed(stereo, {}, {"static_coverage": 0.5})
    assert "timing is not all that differs" in StereoStudy.verdict(whole, less)


def test_cameras_that_moved_leave_no_control(read_report: ReadReport) -> None:
    page = read_report(timing=msgspec.structs.replace(TIMING, moving_cameras={"cam2": 3.0}))
    assert "Things at rest are the control" not in page.text
    assert "nothing in the pictures is a control" in page.text


def test_pictures_that_are_not_of_one_instant_are_not_called_synchronized(
    read_report: ReadReport, whole: CompareResult
) -> None:
    stereo = changed(found(whole, "stereo"), LOST, LOST)
    apart = msgspec.structs.replace(whole.timing, synchronized=False, offset=True, late_ms=33.0)
    page = read_report(whole, stereo, timing=apart, rig_timing=None, verdict="They were not.")
    assert "As recorded against offset" in page.text
    assert "Synced" not in page.text
    assert "synchronized cameras; these were not" in page.text
    assert "in the pictures as they were recorded" in page.text
    assert "comes from timing alone" not in page.text
    assert "they are measured equally well in both (67.3 % and 67.3 %)." in page.text


def test_a_camera_that_is_late_is_named_in_the_studies_it_is_part_of(
    read_report: ReadReport, whole: CompareResult
) -> None:
    right, late = "cam_right", {"synchronized": False, "offset": True, "late_ms": 33.0, "shift_ms": 33.0}
    cameras = [
        msgspec.structs.replace(one, **late) if one.other == right else one
        for one in whole.rig_timing.cameras
    ]
    rig = msgspec.structs.replace(whole.rig_timing, cameras=tuple(cameras))
    page = read_report(whole, rig_timing=rig)
    assert "Synchronized against offset" in page.text
    pair, many = (page.text.rindex(part) for part in ("Depth from cameras", "Depth from 3 cameras"))
    assert "Synced" in page.text[pair : pair + 120]
    assert "Recorded" in page.text[many : many + 120]
    assert "synchronized cameras; these were not" in page.text
    table = page.text[page.text.rindex("Time offset of each camera against cam_left") :]
    assert re.match(
        r".*?cam_middle\s*0\.1 ± 0\.4 ms late\s*the same instant\s*"
        r"cam_right\s*33\.0 ± 0\.4 ms late\s*--time-shift-ms cam_right=33",
        table,
    )


def test_without_ground_truth_nothing_is_called_correct(read_report: ReadReport) -> None:
    blind = {"mover_within_2pct": None, "static_within_2pct": None}
    page = read_report(RESULT, changed(STEREO, blind, {**blind, "mover_coverage": 0.118}))
    assert "orrectly" not in page.text
    assert "12 % of the moving surface given a distance" in page.text
    assert "The true distances are not known" in page.text


def test_a_panorama_alone_speaks_of_its_overlap(read_report: ReadReport) -> None:
    page = read_report(RESULT, skipped("stereo", "only one camera <looks> that way"))
    assert "1.31 px of misfit" in page.text
    assert "23.4 px of misfit" in page.text
    assert "Depth was not measured: only one camera <looks> that way" in page.text
    assert not page.all("svg")


def test_a_panorama_that_lost_what_moves_says_how_much(read_report: ReadReport) -> None:
    panorama = changed(PANORAMA, {"mover_found": 0.98}, {"mover_misfit_px": None, "mover_found": 0.07})
    page = read_report(RESULT, skipped("stereo"), panorama)
    assert "7 % of moving things in both pictures" in page.text.replace("\u202f", " ")


def test_a_panorama_is_judged_by_what_moves_where_that_is_known(read_report: ReadReport) -> None:
    panorama = changed(PANORAMA, {"mover_misfit_px": 2.5}, {"mover_misfit_px": 31.4})
    panorama = msgspec.structs.replace(panorama, reason="52 % overlap")
    page = read_report(RESULT, skipped("stereo"), panorama)
    assert page.text.index("2.50 px of misfit of moving things") < page.text.index("31.4 px of misfit")
    assert "Misfit" in page.text
    assert "5 instants (selection: 52 % overlap)" in page.text


def test_depth_alone_says_why_there_is_no_panorama(read_report: ReadReport) -> None:
    page = read_report(RESULT, skipped("panorama", "the pictures do not overlap"), rig_timing=None)
    assert "No panorama was made: the pictures do not overlap" in page.text
    assert len(page.all("table")) == 1


def test_with_nothing_measured_the_page_says_so_and_claims_nothing(read_report: ReadReport) -> None:
    nothing: dict[str, Any] = {
        "rig_timing": None,
        "sync_residual_us": None,
        "sync_bound_us": None,
        "versions": {},
    }
    page = read_report(RESULT, skipped("stereo"), skipped("panorama"), **nothing)
    assert "Depth was not measured" in page.text
    assert "No panorama was made" in page.text
    assert not page.all("table")
    assert "claim" not in {attributes.get("class", "").split(" ")[0] for _, attributes in page.elements}
    assert "None" not in page.text


def test_a_measure_has_one_name_and_an_interval_one_decimal(
    read_report: ReadReport, whole: CompareResult
) -> None:
    page = read_report(whole)
    assert page.text.count("Measured correctly") == 4
    assert "87.1 to 92.5" in page.text
    assert "Brightness mismatch" not in page.text
    conditions = page.text[page.text.index("All conditions") :]
    assert re.match(r".*session naive\s*another recording, not paired by instant", conditions)
    assert conditions.count("each camera off by a different delay") == 1


def test_the_drawn_condition_is_listed_once(read_report: ReadReport, whole: CompareResult) -> None:
    drawn = ConditionResult(name="distinct", studies=(found(whole, "multiview"), STEREO))
    page = read_report(whole, conditions=(drawn,))
    conditions = page.text[page.text.index("All conditions") : page.text.index("Every instant by itself")]
    assert conditions.count("unsynchronized") == 1
    assert "drawn at random for each instant" in conditions


def test_depth_from_all_cameras_stands_beside_its_control(
    read_report: ReadReport, whole: CompareResult
) -> None:
    page = read_report(whole)
    part = page.text[
        page.text.rindex("With all cameras at once") : page.text.rindex("Where the cameras stand")
    ]
    assert re.match(r".*Measured correctly.*?97\.0 %\D*1\.2 %\D*87\.0 %\D*87\.0 %", part)
    assert re.match(r".*Points in space.*?12 346\s*45\s*98 765", part)
    assert re.match(r".*Reconstructed surface.*? to within 1 cm .F-score.:.*?81\.0 %", part)
    assert "each camera off by a different delay of up to 66 ms, drawn at random for each instant" in part
    assert "No depth of cam_dark: its picture is black." in part
    assert "Confirmed by other cameras" not in part
    assert "Distance from all cameras, synchronized" in [image["alt"] for image in page.all("img")]


def test_poses_of_single_instants_are_told_and_drawn(read_report: ReadReport, whole: CompareResult) -> None:
    page = read_report(whole)
    part = page.text[page.text.rindex("Where the cameras stand") :]
    assert "delays put the cameras in wrong places" in part
    assert re.match(r".*?Camera pairs placed correctly.*?100\.0 %\s*20\.0 %", part)
    assert re.match(r".*Angle error.*?0\.05°\s*27°", part)
    assert "cam_left on time, cam_middle 67 ms late, cam_right 33 ms early" in part
    drawn = [svg["aria-label"] for svg in page.all("svg") if "placed correctly" in svg.get("aria-label", "")]
    assert "instant 2: synchronized 100 %, unsynchronized 0 %" in drawn[0].replace(wording.GAP, " ")
    assert len(page.all("rect")) == 4


def test_what_was_not_looked_at_says_why_and_draws_nothing(read_report: ReadReport) -> None:
    page = read_report(
        RESULT, skipped("multiview", "it takes three <cameras>"), skipped("poses", "what moves is small")
    )
    assert "With all cameras at once" not in page.text
    assert "not measured: it takes three <cameras>" in page.text
    assert "not measured: what moves is small" in page.text


def test_the_tables_in_words_read_as_in_the_report(read_report: ReadReport) -> None:
    words = report_words(RESULT)
    assert [words[name] for name in ("synced", "offset", "unsynchronized")] == [
        "Synchronized",
        "67\u202fms late",
        "unsynchronized",
    ]
    text = read_report().text.replace("\u202f", " ")
    for table in words["tables"]:
        assert len(table["groups"]) == len(table["columns"])
        for row in table["rows"]:
            values = r"\D*?".join(re.escape(cell.replace("\u202f", " ")) for cell in row[1:])
            assert re.search(f"{re.escape(row[0])}.*?{values}", text), row
    assert "Things at rest (control)" in words["tables"][-1]["groups"]


def test_in_words_too_nothing_is_called_synchronized_that_cannot_be() -> None:
    result = with_studies(RESULT, changed(STEREO, LOST, LOST))
    words = report_words(msgspec.structs.replace(result, timing=None, rig_timing=None))
    assert words["synced"] == "As recorded"
    assert words["tables"][0]["columns"][0] == "Recorded"
