"""The verdict says what the figures say, also where they say nothing."""

from typing import Any

import msgspec
import pytest

from capture_app.session.format.calibration import LEVELS, LensKnowledge
from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from reconstruction.checks.poses.pose_study import PoseFacts
from reconstruction.method.comparison_results import CompareResult, OffsetTolerance
from reconstruction.method.study_result import StudyResult
from reconstruction.method.timing import SessionTiming, Timing, with_depth
from reconstruction.report.findings import claims, verdict
from reconstruction.report.tolerance_report import tolerance_sentence
from tests.unit.reconstruction.report.results import study


def result(*studies: StudyResult[Any], moving_share: float = 0.1, **more: object) -> CompareResult:
    """A comparison of these studies alone."""
    found = CompareResult(
        session="jump",
        offset_ms=66,
        offset_frames=2,
        actual_offset_ms=66.7,
        calibration="",
        moving_share=moving_share,
        studies=studies,
    )
    return msgspec.structs.replace(found, **more)


def told(*studies: StudyResult[Any], **more: Any) -> str:
    """The verdict on these studies alone."""
    return verdict(result(*studies, **more))


def stereo(synced: float, offset: float, still: float = 0.8, *, truth: bool = True) -> StudyResult[Any]:
    def values(moving: float, static: float) -> dict[str, float]:
        found = {"mover_coverage": moving, "static_coverage": static}
        return {**found, "mover_within_2pct": moving} if truth else found

    return study("stereo", ("a", "b"), values(synced, 0.8), values(offset, still))


def panorama(
    synced: float, offset: float | None, found: tuple[float, float] = (0.9, 0.9)
) -> StudyResult[Any]:
    before, after = (
        {"mover_misfit_px": misfit, "mover_found": share}
        for misfit, share in zip((synced, offset), found, strict=True)
    )
    return study("panorama", ("a", "b"), before, after)


def test_a_clear_difference_is_told_with_its_control() -> None:
    text = told(stereo(0.97, 0.01), panorama(2.0, 20.0))
    assert "the right distance is found for 97 % of what moves" in text
    assert "67 ms late, for 1 %" in text
    assert "timing alone makes the difference" in text
    assert "within 2.0 pixels" in text


def test_without_truth_nothing_is_called_right() -> None:
    text = told(stereo(0.8, 0.05, truth=False))
    assert "right" not in text
    assert "both pictures agree on" in text


def test_a_control_that_changes_takes_the_conclusion_away() -> None:
    fallen = stereo(0.97, 0.01, still=0.5)
    text = told(fallen)
    assert "timing alone" not in text
    assert "Did the cameras move" in text
    shaky = Timing(reference="a", other="b", reason="why", moving_cameras={"a": 3.0})
    text = told(fallen, timing=shaky)
    assert text.startswith("a moved while recording")
    assert "Did the cameras move" not in text


def test_cameras_that_were_never_together_are_not_called_synchronized() -> None:
    def seen(moving: float, rows: float) -> StudyResult[Any]:
        values = {
            "mover_coverage": moving,
            "static_coverage": 0.96,
            "mover_epipolar_px": rows,
            "static_epipolar_px": 0.05,
        }
        return study("stereo", ("a", "b"), values, values)

    unknown, sure = (
        Timing(reference="a", other="b", reason="too few points"),
        Timing(reference="a", other="b", synchronized=True, late_ms=0.1, uncertainty_ms=0.6),
    )
    lost = seen(0.04, 9.8)
    text = told(lost, timing=with_depth(unknown, lost))
    assert text.startswith("These cameras were not synchronized:")
    assert "a distance is found for 4 % of what moves and for 96 % of what stands still" in text
    assert "is found 10 pixels off its rows" in text
    assert "could not be measured: too few points." in text
    # Where points tell otherwise, neither is certain.
    torn = with_depth(sure, lost)
    assert not torn.synchronized
    assert not torn.offset
    assert "do not show whether" in told(lost, timing=torn)
    # A blank thing that no pair can match, and a pair that matches it well, say nothing against the times.
    for one in (seen(0.04, 0.2), seen(0.9, 1.5), stereo(0.04, 0.02)):
        assert with_depth(unknown, one) == unknown
        assert with_depth(sure, one) == sure


def test_what_a_panorama_lost_is_told_where_no_misfit_is_left() -> None:
    for misfit in (None, 2.0):
        text = told(panorama(2.0, misfit, (0.97, 0.11)))
        assert "97 % of what moves is in both" in text
        assert "11 % with one picture 67 ms late" in text


def test_cameras_beside_the_pair_that_are_late_are_named_with_what_mends_them() -> None:
    def camera(name: str, late_ms: float | None, **more: Any) -> Timing:
        sure = late_ms is not None
        return Timing(
            reference="a",
            other=name,
            synchronized=sure and not more,
            offset=bool(more),
            late_ms=late_ms,
            uncertainty_ms=0.6 if sure else None,
            **more,
        )

    pair = camera("b", 0.1)
    late = SessionTiming(reference="a", cameras=(pair, camera("c", -40.0, shift_ms=-40.0), camera("d", None)))
    text = told(stereo(0.97, 0.01), timing=pair, rig_timing=late)
    assert text.startswith("These cameras were not synchronized. Against a, c is 40.0")
    assert "For a and b: When both pictures show the same instant" in text
    assert "Against a, c is 40.0 ± 0.6 ms early (by what moves; 95 %). --time-shift-ms c=-40 pairs" in text
    assert told(stereo(0.97, 0.01), timing=pair) in text
    turned = Timing(reference="b", other="a", offset=True, late_ms=33.0, uncertainty_ms=0.6, shift_ms=33.0)
    text = told(stereo(0.97, 0.01), timing=turned, rig_timing=late)
    assert "c is 40.0" in text
    assert text.count("--time-shift-ms") == 1
    wandering = camera("c", 0.8, jitter_ms=6.0, reason="c's frames wander by ± 12.0 ms")
    text = told(
        stereo(0.97, 0.01), timing=pair, rig_timing=SessionTiming(reference="a", cameras=(wandering,))
    )
    assert "Against a, c's frames wander by ± 12.0 ms (by what moves; 95 %)" in text
    both = Timing(reference="b", other="c", synchronized=True)
    text = told(stereo(0.97, 0.01), timing=both, rig_timing=late)
    assert text.startswith("These cameras were not synchronized. Against a, c is 40.0")


def test_no_difference_is_said_as_such() -> None:
    assert told(stereo(0.6, 0.58), panorama(3.0, 3.1)).startswith("No clear difference")
    assert told(stereo(0.2, 0.9)).startswith("No clear difference")
    assert told(stereo(0.6, 0.58), moving_share=0.0001).startswith("Almost nothing moves")
    assert told().startswith("Nothing could be measured")


def poses(degraded: bool, late_deg: float | None) -> StudyResult[Any]:
    return study(
        "poses",
        ("a", "b", "c"),
        {"registered": 5, "correct_pairs": 1.0, "rotation_deg": 0.05},
        {"registered": 5, "correct_pairs": 0.0 if degraded else 1.0, "rotation_deg": late_deg},
        facts=PoseFacts(degraded=degraded, tolerance_deg=2.0, truth_source=""),
    )


def test_poses_are_told_where_lateness_harms_them() -> None:
    wrong = told(stereo(0.6, 0.58), poses(True, 28.8), moving_share=0.3)
    assert "to 0.05 degrees" in wrong
    assert "wrong by 29 degrees" in wrong
    assert "no camera can be placed" in told(poses(True, None), moving_share=0.3)
    assert "seem to stand" not in told(stereo(0.97, 0.01), poses(False, 0.06))


def test_where_no_pair_gives_depth_all_cameras_are_told_of() -> None:
    def many(late: float) -> StudyResult[Any]:
        together, apart = (
            {"mover_coverage": 0.95, "static_coverage": 0.8, "mover_within_2pct": right}
            for right in (0.9, late)
        )
        return study("multiview", ("a", "b", "c"), together, apart)

    text = told(many(0.02))
    assert (
        "When the pictures of all 3 cameras are paired as recorded, the right distance is found for 90 %"
        in text
    )
    assert "off by a different delay, for 2 %" in text
    assert "all 3 cameras" not in told(stereo(0.97, 0.01), many(0.02))
    assert told(many(0.85)).startswith("No clear difference")


def test_a_recording_without_common_times_is_called_so_first() -> None:
    text = told(unsynchronized=NOT_SYNCHRONIZED)
    assert text.startswith("This recording is not synchronized, offsets unknown.")


def test_what_could_not_be_made_is_said_with_its_reason() -> None:
    lost: StudyResult[None] = StudyResult(name="panorama", skipped="the pictures share too little")
    unasked: StudyResult[None] = StudyResult(name="poses", skipped="it was not requested", unasked=True)
    assert told(stereo(0.97, 0.01), lost, unasked).endswith(
        "Not made: panorama (the pictures share too little)."
    )
    assert "Not made" not in told(stereo(0.97, 0.01), unasked)


def test_a_calibration_from_pictures_alone_is_called_a_guess() -> None:
    guess = LensKnowledge(why="off by up to 1.0 to 2.0 % (95 %)", is_guess=True)
    sentence = "The calibration is a guess from these pictures alone, focal lengths off by up to 1.0 to 2.0 %"
    assert sentence in told(stereo(0.97, 0.01), lenses=guess)
    assert "guess" not in told(stereo(0.97, 0.01), lenses=msgspec.structs.replace(guess, is_guess=False))


@pytest.mark.parametrize("guess", [False, True])
def test_lenses_that_no_picture_confirms_give_depth_no_verdict(guess: bool) -> None:
    # A sample's lenses were 30 to 79 % off by what was given, and carried "98 % against 15".
    lenses = LensKnowledge(level="not", why="these points lie in one plane", is_guess=guess)
    sentence = f"Depth gives no verdict, with {LEVELS['not']}these points lie in one plane. Calibrate with"
    for late in (0.01, 0.96):
        text = told(stereo(0.97, late), lenses=lenses)
        assert text.startswith(sentence)
        assert "97" not in text
        assert "No clear difference" not in text
    text = told(stereo(0.97, 0.01), panorama(2.0, 20.0), lenses=lenses)
    assert text.startswith("In the panorama, what moves fits together to within 2.0 pixels")
    assert sentence in text
    assert "97" not in text
    assert claims(result(stereo(0.97, 0.01), lenses=lenses)) == ((), "")
    assert claims(result(stereo(0.97, 0.01)))[0]
    curve = OffsetTolerance(
        cameras=("a", "b"),
        measure="mover_coverage",
        points=(stereo(0.97, 0.97), stereo(0.97, 0.01)),
        instants=5,
        decreasing=True,
    )
    assert "97" in tolerance_sentence(curve)
    unsure = tolerance_sentence(msgspec.structs.replace(curve, lenses=lenses))
    assert sentence in unsure
    assert "97" not in unsure


def test_lenses_that_are_known_roughly_show_a_difference_and_exclude_none() -> None:
    # By lenses 2.6 % off, "no clear difference" was said of a sample of 96 against 2 %.
    lenses = LensKnowledge(level="roughly", why="off by up to 2.8 to 5.3 % (95 %)")
    assert "97" in told(stereo(0.97, 0.01), lenses=lenses)
    text = told(stereo(0.97, 0.96), lenses=lenses)
    assert text.startswith(
        f"Depth gives no verdict, with {LEVELS['roughly']}off by up to 2.8 to 5.3 % (95 %)."
    )
