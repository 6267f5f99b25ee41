"""The tables and numbers of a report, honest about what was not measured."""

import re

import msgspec

from reconstruction.report.comparison_report import write_report
from reconstruction.scores.compare_results import ConditionResult
from tests.reconstruction.report.page import Page
from tests.reconstruction.report.results import RESULT, STEREO, STITCH, depth
from tests.reconstruction.report.sample import whole_result


def test_movers_stand_beside_the_static_control(tmp_path):
    page = Page.read(write_report(RESULT, tmp_path))

    row = page.text[page.text.index("Given a distance") :]
    assert re.match(r".*?99\.9 %\D*40\.5 %\D*74\.5 %\D*73\.3 %", row)
    assert "comes from timing alone" in page.text
    row = page.text[page.text.index("Vertical mismatch") :]
    assert re.match(r".*?0\.26 px\s*17\.7 px\s*n/a\s*n/a", row)
    assert "Brightness mismatch" not in page.text
    assert "more strictly" not in page.text


def test_stricter_and_laxer_shares_are_told_where_they_were_taken(tmp_path):
    both = {"mover_within_1pct": 0.905, "mover_within_5pct": 0.993}
    stereo = msgspec.structs.replace(STEREO, synced=depth(**both))
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=stereo), tmp_path))

    assert re.match(r".*more strictly.*?90\.5 %\s*n/a.*less strictly.*?99\.3 %\s*n/a", page.text)


def test_a_control_that_moves_is_admitted(tmp_path):
    shaky = msgspec.structs.replace(STEREO, offset=depth(static_within_2pct=0.6))
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=shaky), tmp_path))

    assert "comes from timing alone" not in page.text
    assert "not all of the difference comes from timing" in page.text


def test_pictures_that_are_not_of_one_instant_are_not_called_synchronized(tmp_path):
    lost = depth(mover_within_2pct=0.005, mover_epipolar_px=9.8, static_epipolar_px=0.05)
    stereo = msgspec.structs.replace(STEREO, synced=lost, offset=lost)
    result = msgspec.structs.replace(whole_result(tmp_path), stereo=stereo, verdict="They were not.")
    page = Page.read(write_report(result, tmp_path))

    assert "As recorded against offset" in page.text
    assert "Synced" not in page.text
    assert "fire together; these did not" in page.text
    assert "in the pictures as they were recorded" in page.text
    assert "comes from timing alone" not in page.text
    assert "they are measured equally well in both (67.3 % and 67.3 %)." in page.text


def test_without_ground_truth_nothing_is_called_correct(tmp_path):
    blind = {"mover_within_2pct": None, "static_within_2pct": None}
    stereo = msgspec.structs.replace(
        STEREO, synced=depth(**blind), offset=depth(**blind, mover_coverage=0.118, static_coverage=0.744)
    )
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=stereo), tmp_path))

    assert "orrectly" not in page.text
    assert "12 % of the moving surface given a distance" in page.text
    assert "The true distances are not known" in page.text


def test_a_panorama_alone_speaks_of_its_overlap(tmp_path):
    only = msgspec.structs.replace(RESULT, stereo=None, stereo_skipped="only one camera <looks> that way")
    page = Page.read(write_report(only, tmp_path))

    assert "1.31 px of misfit" in page.text
    assert "23.4 px of misfit" in page.text
    assert "Depth was not measured: only one camera <looks> that way" in page.text
    assert not page.all("svg")


def test_a_panorama_is_judged_by_what_moves_where_that_is_known(tmp_path):
    stitch = msgspec.structs.replace(
        STITCH,
        synced=msgspec.structs.replace(STITCH.synced, mover_flow_p95_px=2.5),
        offset=msgspec.structs.replace(STITCH.offset, mover_flow_p95_px=31.4),
        reason="52 % overlap",
    )
    page = Page.read(write_report(msgspec.structs.replace(RESULT, stereo=None, stitch=stitch), tmp_path))

    assert page.text.index("2.50 px of misfit of moving things") < page.text.index("31.4 px of misfit")
    assert "Misfit of moving things" in page.text
    assert "5 instants (selection: 52 % overlap)" in page.text


def test_depth_alone_says_why_there_is_no_panorama(tmp_path):
    only = msgspec.structs.replace(RESULT, stitch=None, stitch_skipped="the pictures do not overlap")
    page = Page.read(write_report(only, tmp_path))

    assert "No panorama was made: the pictures do not overlap" in page.text
    assert len(page.all("table")) == 1


def test_with_nothing_measured_the_page_says_so_and_claims_nothing(tmp_path):
    nothing = msgspec.structs.replace(
        RESULT, stereo=None, stitch=None, sync_residual_us=None, sync_bound_us=None, versions={}
    )
    page = Page.read(write_report(nothing, tmp_path))

    assert "Depth was not measured" in page.text
    assert "No panorama was made" in page.text
    assert not page.all("table")
    assert "claim" not in {attributes.get("class", "").split(" ")[0] for _, attributes in page.elements}
    assert "None" not in page.text


def test_a_measure_has_one_name_and_an_interval_one_decimal(tmp_path):
    page = Page.read(write_report(whole_result(tmp_path), tmp_path))

    assert page.text.count("Measured correctly") == 4
    assert "87.1 to 92.5" in page.text
    assert "Brightness mismatch" not in page.text
    conditions = page.text[page.text.index("All conditions") :]
    assert re.match(r".*session naive\s*another recording, not paired by instant", conditions)
    assert conditions.count("each camera off by a different delay") == 1


def test_the_drawn_condition_is_listed_once(tmp_path):
    result = whole_result(tmp_path)
    drawn = ConditionResult(name="distinct", stereo=STEREO, multiview=result.multiview)
    page = Page.read(write_report(msgspec.structs.replace(result, conditions=(drawn,)), tmp_path))

    conditions = page.text[page.text.index("All conditions") : page.text.index("Every instant by itself")]
    assert conditions.count("unsynchronized") == 1
    assert "drawn at random for each instant" in conditions
