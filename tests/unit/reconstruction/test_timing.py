"""Synchronized is said only where zero is certain, by the whole take and by its instants."""

import pytest

from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from reconstruction.common.joined_names import joined_to
from reconstruction.method.timing import (
    Timing,
    judge_timing,
    most_together,
    steady_pairs,
    unseen_ends,
    with_curve_peak,
    with_depth_runs,
    with_planned_delay,
    with_unseen_ends,
    without_common_times,
)
from reconstruction.report.findings import sentences
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.instant_votes import Change, Step

FRAME_MS = 33.3
PAIR = ("L", "R")


def timing_sentences(timing: Timing) -> str:
    """Return what a report says of the second camera's time offset."""
    return sentences("timing.txt", timing=timing)


def judged(offset_ms: float, sd_ms: float, *instants_ms: float, apart_ms: float = 0.0) -> Timing:
    instants = tuple(InstantOffset(k, ms, 0.5, 20) for k, ms in enumerate(instants_ms or (offset_ms,) * 5))
    return judge_timing(PAIR, OffsetFit(offset_ms, sd_ms, "", instants), apart_ms, FRAME_MS)


def test_zero_within_a_small_error_is_synchronized() -> None:
    found = judged(0.4, 0.3)
    assert found.synchronized
    assert not found.offset
    assert found.option == ""
    assert "R is 0.4 ± 0.6 ms late against L" in timing_sentences(found)


def test_without_common_times_nothing_is_called_synchronized() -> None:
    found = without_common_times(judged(0.4, 0.3), f"{NOT_SYNCHRONIZED}: each counts from its own beginning")
    assert not found.synchronized
    assert f"{NOT_SYNCHRONIZED}, and" in found.reason
    assert "do not show whether" in timing_sentences(found)


def test_a_camera_that_was_moved_during_the_take_is_told_and_certifies_nothing() -> None:
    moved = {"R": "R itself was moved by 4.2 pixels before instant 3: only instants 4 to 9 are measured"}
    fit = OffsetFit(0.4, 0.3, "", tuple(InstantOffset(k, 0.4, 0.5, 20) for k in range(5)), moved=moved)
    found = with_unseen_ends(judge_timing(PAIR, fit, 0.0, FRAME_MS), unseen_ends(fit))
    assert (found.synchronized, found.offset) == (False, False)
    assert found.same_frame_ms is None
    assert found.reason == "R was moved during the take"
    assert moved["R"] in timing_sentences(found)
    assert not steady_pairs({PAIR: fit}, FRAME_MS)


def test_staggered_cameras_are_as_planned_and_never_of_one_instant() -> None:
    found = with_planned_delay(judged(0.1, 0.3, apart_ms=25.0), 25.0)
    assert found.offset
    assert found.shift_ms is None
    assert timing_sentences(found).startswith(
        "R is staggered by +25.00 ms on purpose, and is 25.1 ± 0.6 ms late"
    )
    assert sentences("judgement.txt", timing=found) == "staggered on purpose, by +25.00 ms"
    small = with_planned_delay(judged(0.4, 0.3), 0.3)
    assert not small.synchronized
    assert "staggered by 0.30 ms on purpose" in timing_sentences(small)
    assert with_planned_delay(judged(0.4, 0.3), 0.0).synchronized


@pytest.mark.parametrize(
    ("offset_ms", "option"), [(33.5, "--time-shift-ms R=33.5"), (-66.4, "--time-shift-ms R=-66.4"), (7.0, "")]
)
def test_another_offset_is_given_with_the_option_that_mends_it(offset_ms: float, option: str) -> None:
    found = judged(offset_ms, 0.5)
    assert not found.synchronized
    assert found.offset
    assert found.option == option
    text = timing_sentences(found)
    assert text.startswith("These cameras were not synchronized")
    assert f"{abs(offset_ms):.1f} ± 1.0 ms {'earlier' if offset_ms < 0 else 'later'}" in text
    assert option in text if option else "it takes synchronized cameras" in text


def test_times_that_are_known_to_differ_are_no_one_instant() -> None:
    found = judged(0.1, 0.3, apart_ms=10.6)
    assert found.offset
    assert found.late_ms == pytest.approx(10.7)
    assert found.shift_ms is None


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (judged(0.5, 6.0), "a tenth of a frame"),
        (judged(0.0, 0.3, 0.0, 0.1, 28.0, -30.0, 0.2), "2 of 5 instants disagree"),
        (judge_timing(PAIR, OffsetFit(reason="nothing moves"), 0.0, FRAME_MS), "nothing moves"),
    ],
)
def test_what_is_not_sure_certifies_nothing(found: Timing, why: str) -> None:
    assert not found.synchronized
    assert not found.offset
    text = timing_sentences(found)
    assert text.startswith("These pictures do not show whether the cameras were synchronized")
    assert why in text


def test_one_pair_of_images_that_is_off_takes_the_certificate_away() -> None:
    found = judged(0.2, 0.3, 0.1, 7.1, 0.4, -0.3, 0.2, 0.3, 0.1, 0.4, 0.2, 0.3)
    assert not found.synchronized
    assert not found.offset
    text = timing_sentences(found)
    assert "Offsets below 7 ms cannot be measured: 1 of 10 instants disagree" in text


@pytest.mark.parametrize(("unseen", "certain"), [((3, 12), True), ((12, 15, 20, 29), False)])
def test_an_offset_that_is_seen_at_one_end_of_the_motion_only_certifies_nothing(
    unseen: tuple[int, ...], certain: bool
) -> None:
    instants = tuple(InstantOffset(k, 0.1, 0.5, 20) for k in (0, 1, 2, 7, 8))
    pair = OffsetFit(0.1, 0.4, "", instants, unvoted=unseen)
    # A rig of three knows the offset better than the two, and has no instants of its own.
    for fit in (pair, OffsetFit(0.0, 0.2)):
        found = with_unseen_ends(judge_timing(PAIR, fit, 0.0, FRAME_MS), unseen_ends(pair))
        assert found.synchronized == certain
        assert (found.same_frame_ms is not None) == certain
        assert certain or "surely seen at instants 1 to 7 alone" in timing_sentences(found)


def test_a_single_instant_at_the_end_does_not_show_that_no_frame_was_dropped_before_it() -> None:
    """A painted take's fifth frame was dropped; four points of the last instant matched wrongly, at 0."""
    instants = tuple(InstantOffset(k, -0.5, 1.0, 5) for k in (0, 1, 2, 3, 29))
    hidden = OffsetFit(-0.5, 0.8, "", instants, unvoted=(*range(4, 11), 23, 24, 25, 27, 28))
    assert "instants 1 to 3 alone" in unseen_ends(hidden)
    more = InstantOffset(28, -0.5, 1.0, 5)
    shown = OffsetFit(-0.5, 0.8, "", (*instants[:-1], more, instants[-1]), unvoted=hidden.unvoted[:-1])
    assert not unseen_ends(shown)


def test_a_camera_of_a_rig_is_certified_by_a_chain_of_its_own_pairs() -> None:
    """A pair beside the measured ones is not asked for: in a rig of many it may see little in common."""
    instants = tuple(InstantOffset(k, 0.1, 0.5, 20) for k in range(9))
    whole, part = (OffsetFit(0.1, 0.4, "", instants, unvoted=unseen) for unseen in ((), (12, 15, 20, 29)))
    dropped = OffsetFit(0.1, 0.4, "", instants, change=Change(steps=(Step(5, 1, 5, 5),)))
    pairs = {("a", "b"): whole, ("b", "c"): whole, ("c", "d"): part, ("d", "e"): whole, ("b", "f"): dropped}
    assert joined_to("a", steady_pairs(pairs, FRAME_MS)) == {"a", "b", "c"}
    assert joined_to("a", steady_pairs(pairs | {("c", "e"): whole}, FRAME_MS)) == {*"abcde"}
    assert not steady_pairs({("a", "b"): OffsetFit(reason="too few moving points")}, FRAME_MS)


@pytest.mark.parametrize(
    "odd_ms",
    [(-9, 7, -12, 11, 3, -6, 10, -8, 0.5, 9), (0, 0, 0, 0, 14, 0, 0, 0, 0, 0)],
    ids=["jitter", "one"],
)
def test_a_reference_whose_images_are_off_singly_leaves_its_rig_without_a_certificate(
    odd_ms: tuple[float, ...],
) -> None:
    """Their mean is zero, and the rig's offsets are means: "cam1 is 0.1 ms late" was certified."""
    steady, odd = (
        OffsetFit(0.1, 0.4, "", tuple(InstantOffset(k, ms, 0.5, 20) for k, ms in enumerate(late_ms)))
        for late_ms in ((0.1,) * 10, odd_ms)
    )
    pairs = {("a", "b"): odd, ("a", "c"): odd, ("b", "c"): steady}
    assert joined_to("a", steady_pairs(pairs, FRAME_MS)) == {"a"}
    assert joined_to("b", steady_pairs(pairs, FRAME_MS)) == {"b", "c"}


def test_a_rig_is_measured_against_the_cameras_that_are_together() -> None:
    """One late camera of five was the reference: the four others were called early."""
    late = {"a": 10.0, "b": 0.0, "c": 0.1, "d": 0.0}
    steady = {(one, two): late[two] - late[one] for one in late for two in late if one < two}
    assert most_together(("a", "d", *late), steady, FRAME_MS) == "d"
    assert most_together(("c", "a", *late), steady, FRAME_MS) == "c"
    assert most_together(("a", "b"), {("a", "b"): 10.0}, FRAME_MS) == "a"
    assert most_together(("a", *late), {}, FRAME_MS) == "a"


def test_frames_that_wander_about_zero_are_not_synchronized() -> None:
    instants = tuple(
        InstantOffset(k, ms, 1.5, 20) for k, ms in enumerate([-9, 7, -12, 11, 3, -6, 10, -8, 0.5, 9])
    )
    found = judge_timing(PAIR, OffsetFit(0.6, 1.35, "", instants), 0.0, 66.7)
    assert found.offset
    assert found.jitter_ms == pytest.approx(12, abs=4)
    text = timing_sentences(found)
    assert text.startswith("These cameras were not synchronized: R's frames wander by ± ")
    assert "0.6 ± 2.7 ms late on average" in text


@pytest.mark.parametrize(("sd_ms", "certain"), [(0.5, True), (1.4, True), (4.0, False)])
def test_images_whose_own_errors_would_hide_jitter_are_not_certified(sd_ms: float, certain: bool) -> None:
    scatter = [0.8, -1.1, 0.3, 1.2, -0.7, -0.2, 0.9, -1.2]
    instants = tuple(InstantOffset(k, ms * sd_ms, sd_ms, 20) for k, ms in enumerate(scatter))
    found = judge_timing(PAIR, OffsetFit(0.1, 0.4, "", instants), 0.0, FRAME_MS)
    assert found.synchronized == certain
    assert certain or "single images may be off by up to" in timing_sentences(found)


def test_jitter_that_few_exact_instants_miss_is_not_certified() -> None:
    """Two of these images were off by 3.4 and 3.5 ms, which two instants near zero outweighed."""
    late_ms = (1.0, 0.0, -2.1, 0.1, 1.4, -1.8, 0.4, 0.2, 0.1, -2.1, 1.8, -1.4)
    sds_ms = (0.3, 0.35, 0.3, 0.4, 0.5, 0.6, 1.2, 1.9, 1.2, 0.6, 0.5, 0.5)
    measured = zip(late_ms, sds_ms, strict=True)
    instants = tuple(InstantOffset(k, ms, sd_ms, 20) for k, (ms, sd_ms) in enumerate(measured))
    found = judge_timing(PAIR, OffsetFit(-0.15, 0.49, "", instants), 0.0, 33.3)
    assert not found.synchronized
    assert "single images may be off by up to 3.7 ms" in timing_sentences(found)


def test_images_that_disagree_are_not_called_the_same_frame() -> None:
    """Frames that wander by 15 ms, of which 9 and -11 were measured."""
    measured = ((9.2, 0.9), (0.8, 2.1), (-10.6, 0.6), (1.1, 0.5), (2.5, 1.8))
    instants = tuple(InstantOffset(k, ms, sd_ms, 50) for k, (ms, sd_ms) in enumerate(measured))
    found = judge_timing(PAIR, OffsetFit(1.0, 1.5, "", instants), 0.0, 33.3)
    assert (found.synchronized, found.offset, found.same_frame_ms) == (False, False, None)


def test_offsets_that_drift_over_the_take_are_the_geometrys() -> None:
    drift = [-1.4, -4, -9, -14, -19, -24, -20, -16, -11, -6.2]
    instants = tuple(InstantOffset(k, ms, 1.0, 20) for k, ms in enumerate(drift))
    found = judge_timing(PAIR, OffsetFit(-8.1, 0.95, "", instants), 0.0, 16.7)
    assert not found.synchronized
    assert not found.offset
    assert "drifts between -24.0 and -1.4 ms, by clocks or a wrong calibration" in timing_sentences(found)


def test_a_slow_drift_whose_ends_are_off_is_not_certified() -> None:
    slow, slower = (judged(1.5, 0.9, *(1.5 + ms * (k - 10) for k in range(21))) for ms in (0.05, 0.2))
    assert slow.synchronized
    assert not slower.synchronized
    assert slower.reason == "the offset changes over the take, to +3.5 ms"


def test_a_slope_within_the_error_of_a_clear_offset_is_not_called_a_change() -> None:
    """A take 6 ms late beside a television was said to change to +8.0 ms; its offset was 5.6 ± 2.0 ms."""
    slope = [5.6 + 0.2 * (k - 10) for k in range(21)]
    within, beyond = (judged(5.6, sd_ms, *slope) for sd_ms in (1.0, 0.5))
    assert (within.offset, within.reason) == (True, "")
    assert (beyond.offset, beyond.reason) == (True, "the offset changes over the take, to +7.6 ms")


def test_a_slope_of_an_offset_that_is_known_poorly_is_not_called_a_change() -> None:
    """A take before a television was said to change to -5.9 ms; its offset was 0.4 ± 4.6 ms."""
    slope = [1.5 + 0.2 * (k - 10) for k in range(21)]
    poor, good = (judged(1.5, sd_ms, *slope) for sd_ms in (2.3, 0.9))
    assert (poor.offset, poor.synchronized, good.synchronized) == (False, False, False)
    assert poor.reason == "the error of the measured offset is more than a tenth of a frame"
    assert good.reason == "the offset changes over the take, to +3.5 ms"


def test_a_calibration_that_does_not_fit_leaves_nothing_to_depth() -> None:
    found = judge_timing(PAIR, OffsetFit(reason="it does not fit", misfit_px=12.8), 0.0, FRAME_MS)
    assert with_curve_peak(found, dict.fromkeys(range(8), 33.3), FRAME_MS) == found


@pytest.mark.parametrize(("offset_ms", "verdict"), [(0.2, "of the same frame"), (16.7, "not synchronized")])
def test_a_calibration_that_had_to_be_corrected_is_named_and_certifies_nothing(
    offset_ms: float, verdict: str
) -> None:
    instants = tuple(InstantOffset(k, offset_ms, 0.5, 20) for k in range(8))
    fit = OffsetFit(offset_ms, 0.4, "", instants, misfit_px=12.8)
    found = judge_timing(PAIR, fit, 0.0, FRAME_MS)
    assert not found.synchronized
    assert found.offset == (offset_ms > 1)
    text = timing_sentences(found)
    assert verdict in text
    assert "points at rest are 12.8 pixels off their epipolar lines" in text
    assert with_curve_peak(found, dict.fromkeys(range(8), 33.3), FRAME_MS) == found


def test_a_curve_that_is_highest_elsewhere_takes_the_certificate_away() -> None:
    sure, unknown = judged(0.1, 0.3), judge_timing(PAIR, OffsetFit(reason="why"), 0.0, FRAME_MS)
    assert with_curve_peak(sure, dict.fromkeys(range(8), 0.0), FRAME_MS).synchronized
    assert not with_curve_peak(sure, dict.fromkeys(range(8), FRAME_MS), FRAME_MS).synchronized
    assert not with_curve_peak(unknown, dict.fromkeys(range(8), 0.0), FRAME_MS).synchronized
    by_depth = with_curve_peak(unknown, dict.fromkeys(range(8), -FRAME_MS), FRAME_MS)
    assert by_depth.offset
    assert by_depth.late_ms == pytest.approx(FRAME_MS)
    assert (
        "about 33 ms later than L's, where most depth is found. This is accurate to one frame only"
        in timing_sentences(by_depth)
    )
    assert "95 %" not in timing_sentences(by_depth)
    # From one or two instants nothing follows.
    assert with_curve_peak(sure, dict.fromkeys(range(2), FRAME_MS), FRAME_MS).synchronized
    assert not with_curve_peak(unknown, dict.fromkeys(range(2), -FRAME_MS), FRAME_MS).offset


def test_curves_that_are_highest_here_and_there_say_nothing() -> None:
    unknown = judge_timing(PAIR, OffsetFit(reason="why"), 0.0, FRAME_MS)
    assert (
        with_curve_peak(unknown, dict(enumerate((0.0, -FRAME_MS, -FRAME_MS, 0.0, FRAME_MS))), FRAME_MS)
        == unknown
    )


@pytest.mark.parametrize("known", [OffsetFit(reason="why"), OffsetFit(2.4, 1.0)])
def test_a_frame_that_only_depth_saw_dropped_takes_the_common_frame_away(known: OffsetFit) -> None:
    """Twelve of sixteen instants find most depth as recorded, and the last four a frame later."""
    peaks = {2 * k: 0.0 if k < 12 else FRAME_MS for k in range(16)}
    motion = judge_timing(PAIR, known, 0.0, FRAME_MS)
    assert with_curve_peak(motion, peaks, FRAME_MS).same_frame_ms is not None
    found = with_curve_peak(with_depth_runs(motion, peaks, FRAME_MS), peaks, FRAME_MS)
    assert found.same_frame_ms is None
    assert not found.synchronized
    assert found.disagreeing == (24, 26, 28, 30)
    text = timing_sentences(found)
    assert "do not show whether the cameras were synchronized" in text
    assert "the second picture +33 ms later at instants 24 to 30, and as recorded at most others" in text


@pytest.mark.parametrize("odd", [0, 3, 6])
def test_the_last_instants_depth_alone_tells_of_a_drop_where_motion_tells_nothing(odd: int) -> None:
    """Of four instants the last found three times as much depth a frame later: the frame was dropped."""
    peaks = {**dict.fromkeys(range(7), 0.0), odd: -FRAME_MS}
    for known in (OffsetFit(reason="why"), OffsetFit(2.4, 1.0)):
        motion = judge_timing(PAIR, known, 0.0, FRAME_MS)
        found = with_curve_peak(with_depth_runs(motion, peaks, FRAME_MS), peaks, FRAME_MS)
        # One instant between others may be a wrong match, and motion outweighs one instant.
        hidden = known.offset_ms is None and odd in (0, 6)
        assert (found.same_frame_ms is None) == hidden
        assert (f"-33 ms later at instant {odd}, and as" in timing_sentences(found)) == hidden


def test_curves_that_are_highest_as_recorded_tell_the_frame() -> None:
    unsure, late = judged(2.4, 1.0), judged(7.0, 0.5)
    found = with_curve_peak(unsure, {**dict.fromkeys(range(7), 0.0), 7: FRAME_MS}, FRAME_MS)
    assert not found.synchronized
    assert not found.offset
    text = timing_sentences(found)
    assert text.startswith("These pictures are of the same frame")
    assert "Offsets below 4 ms cannot be measured: the measured offset is neither" in text
    assert "R is 2.4 ± 2.0 ms late" in text
    # A lateness that was measured is told, however depth is paired best.
    assert timing_sentences(
        with_curve_peak(late, dict.fromkeys(range(8), 0.0), FRAME_MS)
    ) == timing_sentences(late)


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (
            judged(0.5, 3.0),
            "Offsets below 6 ms cannot be measured: the error of the measured offset is more than a tenth",
        ),
        (
            judged(0.7, 0.3),
            "Offsets below 1 ms cannot be measured: the measured offset is neither clearly zero",
        ),
    ],
)
def test_the_frame_is_told_where_its_neighbours_are_far(found: Timing, text: str) -> None:
    assert not found.synchronized
    assert timing_sentences(found).startswith(f"These pictures are of the same frame. {text}")
    assert with_curve_peak(found, dict.fromkeys(range(8), FRAME_MS), FRAME_MS).same_frame_ms is None
    assert without_common_times(found, NOT_SYNCHRONIZED).same_frame_ms is None


def test_cameras_that_moved_are_named() -> None:
    fit = OffsetFit(0.0, 0.3, "", ())
    assert sentences("motion.txt", timing=judge_timing(PAIR, fit, 0.0, FRAME_MS)) == ""
    one = sentences("motion.txt", timing=judge_timing(PAIR, fit, 0.0, FRAME_MS, {"R": 3.21}))
    assert one.startswith("R moved while recording")
    assert "3.2 pixels" in one


@pytest.mark.parametrize(
    ("peaks", "certain"), [((2, 5, 9), False), ((2, 5, 9, 24), True), ((2, 10, 18), True)]
)
def test_depth_at_one_end_of_the_motion_tells_no_common_frame(peaks: tuple[int, ...], certain: bool) -> None:
    """Slow boards of which a frame was dropped at 14: depth was clear at 2, 5 and 9 only."""
    instants = tuple(InstantOffset(k, -0.4, 1.5, 5) for k in (0, 2, 29))
    fit = OffsetFit(-0.4, 1.5, "", instants, unvoted=(1, *range(3, 11), 23, 27, 28))
    motion = with_unseen_ends(judge_timing(PAIR, fit, 0.0, FRAME_MS), unseen_ends(fit))
    assert motion.same_frame_ms is None
    found = with_curve_peak(motion, dict.fromkeys(peaks, 0.0), FRAME_MS)
    assert (found.same_frame_ms is not None) == certain
