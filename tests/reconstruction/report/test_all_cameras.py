"""The sections of a report on all cameras at once."""

import re

import msgspec

from reconstruction.report import wording
from reconstruction.report.comparison_report import write_report
from tests.reconstruction.report.page import Page
from tests.reconstruction.report.results import RESULT
from tests.reconstruction.report.sample import whole_result


def test_depth_from_all_cameras_stands_beside_its_control(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

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


def test_poses_of_single_instants_are_told_and_drawn(tmp_path):
    result = whole_result(tmp_path)
    page = Page.read(write_report(result, tmp_path))

    part = page.text[page.text.rindex("Where the cameras stand") :]
    assert "delays put the cameras in wrong places" in part
    assert re.match(r".*?Camera pairs placed correctly.*?100\.0 %\s*20\.0 %", part)
    assert re.match(r".*Angle error.*?0\.05°\s*27°", part)
    assert "cam_left on time, cam_middle 67 ms late, cam_right 33 ms early" in part
    drawn = [svg["aria-label"] for svg in page.all("svg") if "placed correctly" in svg.get("aria-label", "")]
    assert "instant 2: synchronized 100 %, unsynchronized 0 %" in drawn[0].replace(wording.GAP, " ")
    assert len(page.all("rect")) == 4


def test_what_was_not_looked_at_says_why_and_draws_nothing(tmp_path):
    none = msgspec.structs.replace(
        RESULT, multiview_skipped="it takes three <cameras>", poses_skipped="what moves is small"
    )
    page = Page.read(write_report(none, tmp_path))

    assert "With all cameras at once" not in page.text
    assert "not measured: it takes three <cameras>" in page.text
    assert "not measured: what moves is small" in page.text
