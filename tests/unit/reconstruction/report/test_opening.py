"""The first screen: what it is of, its time error beside the tolerated delay, one large picture."""

import html
import re
from pathlib import Path

import msgspec
import pytest

from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.study_result import Interval
from reconstruction.method.timing import SessionTiming
from reconstruction.pages.page import as_template
from reconstruction.report.findings import claims, exactness_view, verdict
from reconstruction.time_offsets.crossings import InstantOffset
from reconstruction.time_offsets.instant_votes import Change, Step
from tests.unit.reconstruction.report.conftest import ReadReport
from tests.unit.reconstruction.report.results import (
    RESULT,
    STEREO,
    TIMING,
    changed,
    greys,
    whole_result,
    with_pictures,
)


def shown(text: str) -> str:
    return text.replace(wording.GAP, " ")


@pytest.mark.parametrize(
    ("origin", "word"), [("simulated", "Simulated"), ("captured", "Captured"), ("imported", "Imported")]
)
def test_where_the_pictures_come_from_is_said_first(read_report: ReadReport, origin: str, word: str) -> None:
    page = read_report(origin=origin, camera_count=5, instant_count=1)
    assert page.text.index(word) < page.text.index("Synchronized cameras measure")
    assert "5 cameras, 1 instant;" in page.text


def exactness(result: CompareResult) -> dict[str, str]:
    """The tile as the page shows it: both times with their sources, and the conclusion."""
    template = as_template('{% include "exactness.html" %}')
    tile = html.unescape(template.render(result=result, running=(), **exactness_view(result)))
    (error, error_source), (tolerated, tolerated_source) = re.findall(
        r"<b>(.*)</b> <small>(.*)</small>", tile
    )
    conclusion = "".join(re.findall('<p class="conclusion">(.*)</p>', tile))
    return {
        "error": error,
        "error_source": shown(error_source),
        "tolerated": tolerated,
        "tolerated_source": shown(tolerated_source),
        "conclusion": conclusion,
    }


def test_the_error_stands_beside_the_tolerated_delay(tmp_path: Path) -> None:
    found = exactness(whole_result(tmp_path))
    assert (shown(found["error"]), shown(found["tolerated"])) == ("≤ 50 µs", "3.5 ms")
    assert found["error_source"] == "by the session's own record; 0.1 ± 0.4 ms late by what moves"
    assert shown(found["conclusion"]) == "70 times more accurate than this motion needs."


def test_a_take_that_is_too_coarse_is_called_so(tmp_path: Path) -> None:
    result = msgspec.structs.replace(whole_result(tmp_path), sync_residual_us=9_000.0)
    assert exactness(result)["conclusion"] == "This take is not accurate enough for this motion."


def test_no_record_hides_an_offset_that_was_measured(tmp_path: Path) -> None:
    late = msgspec.structs.replace(TIMING, synchronized=False, offset=True, late_ms=33.3, uncertainty_ms=0.5)
    found = exactness(msgspec.structs.replace(whole_result(tmp_path), timing=late))
    assert found["error"] == "33.3 ± 0.5 ms late"
    assert found["tolerated"] == wording.NOT_AVAILABLE
    assert found["conclusion"] == ""


@pytest.mark.parametrize(("is_offset", "error"), [(False, "± 23 ms"), (True, "33.3 ± 0.5 ms late")])
def test_an_imported_session_states_its_own_error(is_offset: bool, error: str, tmp_path: Path) -> None:
    late = msgspec.structs.replace(TIMING, synchronized=False, offset=True, late_ms=33.3, uncertainty_ms=0.5)
    times = {"sync_residual_us": None, "imported_error": (22_950.0, "by sound")}
    timing = late if is_offset else TIMING
    found = exactness(msgspec.structs.replace(whole_result(tmp_path), timing=timing, **times))
    assert shown(found["error"]) == error
    assert "by sound, by the session's own record" in found["error_source"]
    assert ("± 23 ms" in shown(found["error_source"])) == is_offset
    assert "by what moves" in found["error_source"]


def test_an_offset_of_any_camera_counts(tmp_path: Path) -> None:
    late = msgspec.structs.replace(TIMING, other="cam_far", synchronized=False, offset=True, late_ms=-17.1)
    rig = SessionTiming(reference="cam2", cameras=(TIMING, late))
    found = exactness(msgspec.structs.replace(whole_result(tmp_path), rig_timing=rig))
    assert found["error"] == "17.1 ± 0.4 ms early"
    assert found["error_source"].startswith("cam_far against cam2")
    assert found["conclusion"] == ""


def test_what_was_not_measured_is_not_made_up() -> None:
    found = exactness(msgspec.structs.replace(RESULT, timing=None, sync_residual_us=None))
    assert (found["error"], found["tolerated"]) == (wording.NOT_AVAILABLE, wording.NOT_AVAILABLE)
    assert "not measured" in found["error_source"] + found["tolerated_source"]
    assert found["conclusion"] == ""


def test_unknown_offsets_stand_where_the_error_would(tmp_path: Path, read_report: ReadReport) -> None:
    unknown = {"timing": None, "sync_residual_us": None, "unsynchronized": NOT_SYNCHRONIZED}
    found = exactness(msgspec.structs.replace(RESULT, **unknown))
    assert (found["error"], found["error_source"]) == (wording.NOT_AVAILABLE, NOT_SYNCHRONIZED)
    assert NOT_SYNCHRONIZED in read_report(unsynchronized=NOT_SYNCHRONIZED).text


def test_a_motion_that_tolerates_all_tried_delays_has_a_lower_bound_only(tmp_path: Path) -> None:
    whole = whole_result(tmp_path)
    tolerance = msgspec.structs.replace(whole.tolerance, tolerable_offset_ms=None)
    found = exactness(msgspec.structs.replace(whole, tolerance=tolerance))
    assert shown(found["tolerated"]) == "> 67 ms"
    assert found["conclusion"] == ""


def test_the_depth_picture_is_on_the_first_screen_and_not_again_below(
    tmp_path: Path, read_report: ReadReport
) -> None:
    hero = greys(tmp_path, "stereo_depth", "Distance", (48, 64), 10, 200)
    other = greys(tmp_path, "stereo_movers", "What moves", (48, 64), 20, 100)
    page = read_report(with_pictures(RESULT, other, hero))
    alts = [shown(image["alt"]) for image in page.all("img")]
    assert alts[:2] == ["Distance, synchronized", "Distance, 67 ms late"]
    assert len(alts) == 4
    assert page.text.index("Distance") < page.text.index("Why the instant matters")
    alone = read_report(with_pictures(RESULT, hero))
    assert "See the difference" not in alone.text


@pytest.mark.parametrize(
    ("ratio", "words"), [(1.23, "1.2 times"), (9.96, "10 times"), (68.4, "68 times"), (4312.0, "4 300 times")]
)
def test_a_ratio_is_told_to_two_digits(ratio: float, words: str) -> None:
    assert shown(wording.times(ratio)) == words


def test_the_tile_says_that_nothing_is_certain_where_nothing_is(tmp_path: Path) -> None:
    unsure = msgspec.structs.replace(TIMING, synchronized=False, same_frame_ms=9.0, reason="it is blurred")
    found = exactness(msgspec.structs.replace(whole_result(tmp_path), timing=unsure))
    assert found["tolerated"] == wording.NOT_AVAILABLE
    assert found["tolerated_source"] == "whether the pictures show one instant is not certain"


def test_dropped_frames_are_the_time_error(tmp_path: Path) -> None:
    change = Change(steps=(Step(3, 1, 3, 3),))
    instants = tuple(InstantOffset(k, 0.1 + 33.3 * (k >= 3), 0.3, 20) for k in range(6))
    dropped = msgspec.structs.replace(
        TIMING,
        synchronized=False,
        offset=True,
        change=change,
        instants=instants,
        reason=change.describe("cam3", "cam2"),
    )
    result = msgspec.structs.replace(whole_result(tmp_path), timing=dropped, rig_timing=None)
    found = exactness(result)
    assert shown(found["error"]) == "up to 33 ms"
    assert found["error_source"] == "cam3 is one frame later than cam2 from instant 3 on, by what moves"
    assert found["tolerated_source"] == "the pictures do not show one instant"


def test_a_fraction_that_may_be_anything_is_no_headline() -> None:
    wide = changed(STEREO, {"mover_within_2pct": Interval(value=0.96, low=0.03, high=1.0)})
    assert claims(msgspec.structs.replace(RESULT, studies=(STEREO,)))[0]
    assert not claims(msgspec.structs.replace(RESULT, studies=(wide,)))[0]


def test_a_calibration_that_points_at_rest_do_not_fit_is_in_the_verdict() -> None:
    for px, said in ((None, False), (0.2, False), (0.8, True)):
        text = verdict(msgspec.structs.replace(RESULT, rest_error_px=px, rest_points=900))
        assert ("Warning: this depth is inaccurate: points at rest fit within 0.80 px" in text) == said
