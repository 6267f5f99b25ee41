"""The verdict says what the figures say, also where they say nothing."""

from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from reconstruction.report.findings import verdict
from reconstruction.scores.study_result import (
    DepthScores,
    MultiviewComparison,
    MultiviewScores,
    PanoramaComparison,
    PanoramaScores,
    PoseComparison,
    PoseScores,
    StereoComparison,
)
from reconstruction.scores.timing import RigTiming, Timing, with_depth_scores


def stereo(synced: float, offset: float, still: float = 0.8, *, truth: bool = True) -> StereoComparison:
    def scores(moving: float, static: float) -> DepthScores:
        return DepthScores(
            mover_coverage=moving, static_coverage=static, mover_within_2pct=moving if truth else None
        )

    return StereoComparison(
        reference="a", other="b", synced=scores(synced, 0.8), offset=scores(offset, still)
    )


def stitch(
    synced: float, offset: float | None, found: tuple[float, float] = (0.9, 0.9)
) -> PanoramaComparison:
    def scores(misfit: float | None, share: float) -> PanoramaScores:
        return PanoramaScores(mover_misfit_px=misfit, mover_found=share, static_overlap_mad=2.0)

    return PanoramaComparison(
        cameras=("a", "b"), synced=scores(synced, found[0]), offset=scores(offset, found[1])
    )


def test_a_clear_difference_is_told_with_its_control() -> None:
    text = verdict(stereo(0.97, 0.01), stitch(2.0, 20.0), 66.7, 0.1)
    assert "the right distance is found for 97 % of what moves" in text
    assert "67 ms late, for 1 %" in text
    assert "timing alone makes the difference" in text
    assert "within 2.0 pixels" in text


def test_without_truth_nothing_is_called_right() -> None:
    text = verdict(stereo(0.8, 0.05, truth=False), None, 66.7, 0.1)
    assert "right" not in text
    assert "both pictures agree on" in text


def test_a_control_that_changes_takes_the_conclusion_away() -> None:
    fallen = stereo(0.97, 0.01, still=0.5)
    text = verdict(fallen, None, 66.7, 0.1)
    assert "timing alone" not in text
    assert "Did the cameras move" in text
    shaky = Timing(reference="a", other="b", reason="why", moving_cameras={"a": 3.0})
    told = verdict(fallen, None, 66.7, 0.1, timing=shaky)
    assert told.startswith("a moved while recording")
    assert "Did the cameras move" not in told


def test_cameras_that_were_never_together_are_not_called_synchronized() -> None:
    def seen(moving: float, rows: float) -> StereoComparison:
        scores = DepthScores(
            mover_coverage=moving, static_coverage=0.96, mover_epipolar_px=rows, static_epipolar_px=0.05
        )
        return StereoComparison(reference="a", other="b", synced=scores, offset=scores)

    unknown, sure = (
        Timing(reference="a", other="b", reason="too few points"),
        Timing(reference="a", other="b", synchronized=True, late_ms=0.1, uncertainty_ms=0.6),
    )
    lost = seen(0.04, 9.8)
    text = verdict(lost, None, 66.7, 0.1, timing=with_depth_scores(unknown, lost.synced))
    assert text.startswith("These cameras were not synchronized:")
    assert "a distance is found for 4 % of what moves and for 96 % of what stands still" in text
    assert "lies 10 pixels off its rows" in text
    assert "could not be measured: too few points." in text
    # Where points tell otherwise, neither is certain.
    torn = with_depth_scores(sure, lost.synced)
    assert not torn.synchronized
    assert not torn.offset
    assert "cannot be told" in verdict(lost, None, 66.7, 0.1, timing=torn)
    # A blank thing that no pair can match, and a pair that matches it well, say nothing against the times.
    for one in (seen(0.04, 0.2), seen(0.9, 1.5), stereo(0.04, 0.02)):
        assert with_depth_scores(unknown, one.synced) == unknown
        assert with_depth_scores(sure, one.synced) == sure


def test_what_a_panorama_lost_is_told_where_no_misfit_is_left() -> None:
    for misfit in (None, 2.0):
        text = verdict(None, stitch(2.0, misfit, (0.97, 0.11)), 66.7, 0.1)
        assert "97 % of what moves is in both" in text
        assert "11 % with one picture 67 ms late" in text


def test_cameras_beside_the_pair_that_are_late_are_named_with_what_mends_them() -> None:
    def camera(name: str, late_ms: float | None, **more: float) -> Timing:
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
    late = RigTiming(reference="a", cameras=(pair, camera("c", -40.0, shift_ms=-40.0), camera("d", None)))
    text = verdict(stereo(0.97, 0.01), None, 66.7, 0.1, timing=pair, rig=late)
    assert text.startswith("When both pictures show the same instant")
    assert "Against a, c is 40.0 ± 0.6 ms early (by what moves; 95 %). --time-shift-ms c=-40 pairs" in text
    assert verdict(stereo(0.97, 0.01), None, 66.7, 0.1, timing=pair) in text
    turned = Timing(reference="b", other="a", offset=True, late_ms=33.0, uncertainty_ms=0.6, shift_ms=33.0)
    text = verdict(stereo(0.97, 0.01), None, 66.7, 0.1, timing=turned, rig=late)
    assert "c is 40.0" in text
    assert text.count("--time-shift-ms") == 1


def test_no_difference_is_said_as_such() -> None:
    assert verdict(stereo(0.6, 0.58), stitch(3.0, 3.1), 66.7, 0.1).startswith("No clear difference")
    assert verdict(stereo(0.2, 0.9), None, 66.7, 0.1).startswith("No clear difference")
    assert verdict(stereo(0.6, 0.58), None, 66.7, 0.0001).startswith("Almost nothing moves")
    assert verdict(None, None, 66.7, 0.1).startswith("Neither")


def poses(degraded: bool, late_deg: float | None) -> PoseComparison:
    def scores(right: float, degrees: float | None) -> PoseScores:
        return PoseScores(registered=5, correct_pairs=right, rotation_deg=degrees)

    return PoseComparison(
        cameras=("a", "b", "c"),
        synced=scores(1.0, 0.05),
        offset=scores(0.0 if degraded else 1.0, late_deg),
        degraded=degraded,
        tolerance_deg=2.0,
        truth_source="the calibration",
    )


def test_poses_are_told_where_lateness_harms_them() -> None:
    wrong = verdict(stereo(0.6, 0.58), None, 66.7, 0.3, poses(True, 28.8))
    assert "to 0.05 degrees" in wrong
    assert "wrong by 29 degrees" in wrong
    assert "no camera can be placed" in verdict(None, None, 66.7, 0.3, poses(True, None))
    assert "seem to stand" not in verdict(stereo(0.97, 0.01), None, 66.7, 0.1, poses(False, 0.06))


def test_where_no_pair_gives_depth_all_cameras_are_told_of() -> None:
    def many(late: float) -> MultiviewComparison:
        together, apart = (
            MultiviewScores(mover_coverage=0.95, static_coverage=0.8, mover_within_2pct=right)
            for right in (0.9, late)
        )
        return MultiviewComparison(reference="b", cameras=("a", "b", "c"), synced=together, offset=apart)

    text = verdict(None, None, 66.7, 0.1, None, many(0.02))
    assert (
        "When the pictures of all 3 cameras are paired as recorded, the right distance is found for 90 %"
        in text
    )
    assert "off by a different delay, for 2 %" in text
    assert "all 3 cameras" not in verdict(stereo(0.97, 0.01), None, 66.7, 0.1, None, many(0.02))
    assert verdict(None, None, 66.7, 0.1, None, many(0.85)).startswith("No clear difference")


def test_a_recording_without_common_times_is_called_so_first() -> None:
    text = verdict(None, None, 66.7, 0.1, unsynchronized=NOT_SYNCHRONIZED)
    assert text.startswith("This recording is not synchronized, offsets unknown.")
