"""What a take is good for, by its times and by what is missing."""

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from capture_app.common.camera_facts import EXACT_STAMPS, StampAccuracy, StampSource
from capture_app.session.format.common_times import NOT_SYNCHRONIZED, CommonTimes
from capture_app.session.format.manifest import (
    AbsentCamera,
    BurstRecord,
    CameraRecord,
    ImageRecord,
    Manifest,
    MissingImage,
    SkippedFrame,
    SkippedInstant,
    sync_record,
)
from capture_app.session.reading.verdict import (
    GRADE_LIMITS,
    Grade,
    describe_displacement,
    grade_of,
    judge,
    skipped_text,
)

from .conftest import camera_record

MS, US = 1_000_000, 1_000
BURST = BurstRecord(instants_ns=(0, 33 * MS), period_ns=33 * MS)
CAMERAS = (camera_record("left"), camera_record("right"))


def image(
    camera: str, instant: int, late_ns: int, error_ns: int | None = 10 * US, **more: Any
) -> ImageRecord:
    """An image so much after its instant."""
    leader_ns = BURST.instants_ns[instant] + late_ns
    place: dict[str, Any] = {
        "camera": camera,
        "instant": instant,
        "leader_ns": leader_ns,
        "path": "x",
        "bytes": 1,
    }
    return ImageRecord(sha256="0" * 64, uncertainty_ns=error_ns, **{**place, **more})


def take(*images: ImageRecord, missing: tuple[MissingImage, ...] = ()) -> Manifest:
    """A take of two cameras and two instants."""
    about: dict[str, Any] = {
        "name": "take",
        "created": "2026-01-01T00:00:00Z",
        "origin": "captured",
        "software": "test",
    }
    return Manifest(cameras=CAMERAS, burst=BURST, images=images, missing=missing, **about)


@pytest.mark.parametrize(
    ("spread_ns", "grade"),
    [(60 * US, "excellent"), (700 * US, "good"), (5 * MS, "fair"), (16 * MS, "poor")],
)
def test_the_grade_is_by_the_spread_with_the_clocks_error(spread_ns: int, grade: Grade) -> None:
    late = image("right", 0, spread_ns), image("right", 1, 0)
    verdict = judge(take(image("left", 0, 0), image("left", 1, 0), *late))
    assert verdict.grade is grade
    assert verdict.headline.startswith(str(grade))
    assert verdict.spread_ns == spread_ns
    assert verdict.spread_error_ns == 20 * US
    assert verdict.motion_px_per_s == pytest.approx(1e9 / (spread_ns + 20 * US))


def test_the_spread_is_said_with_its_error_bar() -> None:
    assert judge(take(image("left", 0, 0), image("right", 0, 63 * US))).spread == "63 µs ±20 µs"


def test_what_is_missing_is_said() -> None:
    gone = MissingImage(camera="right", instant=1, reason="?", dropped=True)
    images = image("left", 0, 0), image("right", 0, 5 * US, late=True), image("left", 1, 0, substitute=True)
    verdict = judge(take(*images, missing=(gone,)))
    assert (verdict.images, verdict.expected, verdict.dropped) == (3, 4, 1)
    assert "1 of 4 images missing, 1 dropped by the camera" in verdict.headline
    assert "1 from the frame beside it, 1 off the instant" in verdict.headline
    assert "motion up to 40,000 px/s" in verdict.headline
    whole = judge(take(*images, image("right", 1, 0)))
    assert "all 4 images there" in whole.headline


def test_a_take_without_an_image_was_not_taken_and_has_no_grade() -> None:
    reasons = tuple(
        MissingImage(camera=name, instant=instant, reason="the node is not ready")
        for name in ("left", "right")
        for instant in (0, 1)
    )
    verdict = judge(take(missing=reasons))
    assert (verdict.grade, verdict.headline) == ("unknown", "not taken: left, right: the node is not ready")
    assert judge(take()).headline == "not taken: 4 of 4 images missing"
    assert judge(take(missing=reasons), arriving=True).headline.endswith("0 of 4 images, 4 arriving")
    cut = replace(take(missing=reasons), burst=replace(BURST, ordered=9))
    said = judge(cut, arriving=True).headline
    assert said.endswith("cut off after 2 of 9 instants; 0 of 18 images, 4 arriving")


def test_a_take_that_lacks_a_third_of_its_images_is_poor_however_well_synchronized() -> None:
    reasons = tuple(
        MissingImage(camera=camera, instant=instant, reason="?")
        for camera, instant in (("left", 0), ("right", 0), ("right", 1))
    )
    verdict = judge(take(image("left", 1, 0), missing=reasons))
    assert verdict.grade == "poor"
    assert verdict.headline.startswith(
        "poor: right missing: no image came; 3 of 4 images missing; the rest is "
    )


@pytest.mark.parametrize(("cameras", "grade"), [(1, "fair"), (2, "poor")])
def test_a_verdict_is_about_the_rig_and_not_about_who_is_left(cameras: int, grade: Grade) -> None:
    images = [image(camera, instant, 0) for camera in ("left", "right") for instant in (0, 1)]
    whole = take(*images)
    assert judge(whole).grade == "excellent"
    absent = tuple(AbsentCamera(name=f"cam{n}", reason=f"lost {n} s before") for n in range(cameras))
    lacking = replace(whole, burst=replace(whole.burst, absent=absent))
    verdict = judge(lacking)
    assert verdict.grade == grade
    assert verdict.headline.startswith(f"{grade}: cam0 missing: lost 0 s before")
    assert (verdict.images, verdict.expected) == (4, 4 + 2 * cameras)
    assert b"absent" not in msgspec.json.encode(whole), "as the sessions of before, which still open"


@pytest.mark.parametrize(
    ("lacks", "grade", "said"),
    [
        ({"left": 0, "right": 1, "top": 0}, "excellent", "1 of 1800 images missing"),
        ({"left": 0, "right": 12, "top": 0}, "good", "good: right lacks 12 of 600 frames; 12 of 1800"),
        ({"left": 2, "right": 120, "top": 3}, "fair", "fair: right lacks 120 of 600 frames; 125 of 1800"),
        ({"left": 0, "right": 599, "top": 0}, "fair", "fair: right lacks 599 of 600 frames; 599 of"),
        ({"left": 0, "right": 600, "top": 0}, "fair", "fair: right missing: no image came; 600 of"),
        ({"left": 300, "right": 400, "top": 0}, "poor", "poor: right lacks 400 of 600 frames; 700 of"),
        (
            {"left": 30, "right": 30, "top": 30},
            "good",
            "good: 90 of 1800 images missing, no camera delivered",
        ),
    ],
)
def test_the_worst_camera_caps_the_grade_and_is_named_first(
    lacks: dict[str, int], grade: Grade, said: str
) -> None:
    whole = take()
    instants_ns = tuple(33 * MS * number for number in range(600))
    images = [
        replace(image(camera, 0, 0), instant=number, leader_ns=at_ns)
        for number, at_ns in enumerate(instants_ns)
        for camera in lacks
        if number >= lacks[camera]
    ]
    manifest = replace(
        whole,
        cameras=tuple(camera_record(name) for name in lacks),
        burst=replace(whole.burst, instants_ns=instants_ns),
        images=tuple(images),
    )
    verdict = judge(manifest)
    assert verdict.grade == grade
    assert said in verdict.headline


def test_a_camera_without_an_image_is_named_first() -> None:
    """Its process was killed, and the take of the others was called good."""
    verdict = judge(take(*(image("left", instant, 0) for instant in (0, 1))))
    assert verdict.headline.startswith("poor: right missing: no image came; 2 of 4 images missing")


def test_the_grades_are_explained_by_the_limits_that_hold() -> None:
    limits = (100 * US, 1 * MS, 10 * MS)
    assert GRADE_LIMITS == (
        "spread and error together: excellent below 100 µs, good below 1.0 ms, fair below 10 ms"
    )
    graded = [(grade_of(limit - 1 - US, US)[0], grade_of(limit, US)[0]) for limit in limits]
    assert graded == [
        ("excellent", "good"),
        ("good", "fair"),
        ("fair", "poor"),
    ]


def test_a_staggered_take_is_judged_by_how_its_cameras_keep_to_their_plan() -> None:
    late_ns = 8 * MS + 60 * US
    images = (
        image(name, n, delay_ns) for n in (0, 1) for name, delay_ns in (("left", 0), ("right", late_ns))
    )
    verdict = judge(replace(take(*images), cameras=(CAMERAS[0], replace(CAMERAS[1], delay_ns=8 * MS))))
    assert verdict.headline.startswith("staggered, steps of 8 ms: excellent, each as planned to ")
    assert "px/s" not in verdict.headline, "what moves is seen at planned times"


def test_times_without_a_common_clock_have_no_spread_whatever_they_say() -> None:
    unknown = replace(BURST, common_times=CommonTimes(state="unknown"))
    images = (image(name, n, late_ns) for n in (0, 1) for name, late_ns in (("left", 0), ("right", 60 * US)))
    verdict = judge(replace(take(*images), burst=unknown))
    assert (verdict.grade, verdict.spread_ns) == ("unknown", None)
    assert verdict.headline.startswith(NOT_SYNCHRONIZED)


def test_what_cannot_be_judged_is_unknown() -> None:
    unsure = judge(take(image("left", 0, 0, None), image("right", 0, 63 * US), image("left", 1, 0)))
    assert unsure.grade == "unknown"
    assert "not measured: 63 µs apart by the recorded times, whose error is not known" in unsure.headline
    assert unsure.spread == "63 µs"
    alone = judge(take(image("left", 0, 0), image("right", 1, 0)))
    assert alone.grade == "poor", "half of its images are missing"
    assert alone.spread_ns is None
    assert "no two images of one instant" in alone.headline


def test_displacement_is_the_distance_that_things_move_meanwhile() -> None:
    known = {"hard_bound_ns": 1 * MS}
    images = [image("left", 0, 0, 100 * US, **known), image("right", 0, 250 * US, 100 * US, **known)]
    words = describe_displacement(sync_record(CAMERAS, BURST, images, []), 2000.0)
    assert "2000 px/s" in words
    assert "0.50 px between cameras at most" in words
    assert "0.90 px with the error of their times included" in words
    assert "4.50 px" in words
    unsure = [replace(one, uncertainty_ns=None) for one in images]
    assert "not known" in describe_displacement(sync_record(CAMERAS, BURST, unsure, []))


def measured(name: str, against: str = "hall", unknown_ns: int | None = 20 * MS) -> CameraRecord:
    """A webcam, right to 0.1 ms against one of which nobody knows how late it stamps."""
    stamp = StampAccuracy(
        bias_ns=15 * MS,
        uncertainty_ns=100 * US,
        source=StampSource.MOTION,
        against=against,
        against_uncertainty_ns=unknown_ns,
    )
    return camera_record(name, kind="v4l2", stamp=stamp)


def take_of(*cameras: CameraRecord) -> Manifest:
    """A take of one instant, of which each camera's time is known to 150 us."""
    images = tuple(image(camera.name, 0, 0, 150 * US) for camera in cameras)
    return replace(take(*images), cameras=cameras, burst=replace(BURST, instants_ns=(0,)))


def test_what_nobody_knows_of_a_camera_cancels_only_between_those_measured_against_it() -> None:
    left, right, exact = measured("left"), measured("right"), camera_record("exact")
    untold = measured("right", unknown_ns=None)

    def error_ns(*cameras: CameraRecord) -> int:
        error_ns = judge(take_of(*cameras)).spread_error_ns
        assert error_ns is not None
        return error_ns // 2

    assert error_ns(left, right) == 150 * US, "the hall's camera is not here, and need not be"
    assert error_ns(left, right, exact) == 150 * US + 20 * MS
    assert error_ns(left, measured("right", against="door")) == 150 * US + 20 * MS
    assert error_ns(left, measured("right", unknown_ns=14 * MS)) == 150 * US + 20 * MS, (
        "in another mode of it"
    )
    assert error_ns(untold, exact) == 150 * US + untold.facts.assumed_stamp.uncertainty_ns


def test_a_verdict_says_which_camera_was_measured_against_others_than_the_rest() -> None:
    left, right, exact = measured("left"), measured("right"), camera_record("exact", stamp=EXACT_STAMPS)
    assert judge(take_of(left, right)).stamps == ""
    mixed = judge(take_of(left, exact))
    assert mixed.grade == "poor"
    assert mixed.stamps == (
        "stamp error of left not measured except against hall (±20 ms):"
        " capture-app cameras calibrate-time measures it"
    )


def test_times_that_the_pictures_told_are_right_whatever_the_stamps_are() -> None:
    mixed = take_of(measured("left"), camera_record("exact"))
    aligned = CommonTimes(state="aligned", cameras={})
    told = judge(replace(mixed, burst=replace(mixed.burst, common_times=aligned)))
    assert told.spread_error_ns == 300 * US


def test_words_about_a_take_call_cameras_as_their_owners() -> None:
    labelled = replace(CAMERAS[1], facts=replace(CAMERAS[1].facts, label="カメラ右"))
    gone = tuple(MissingImage(camera="right", instant=k, reason="no room") for k in (0, 1))
    whole = take(image("left", 0, 0), image("left", 1, 0), missing=gone)
    one = replace(whole, cameras=(CAMERAS[0], labelled))
    assert "カメラ右 missing: no image came" in judge(one).headline
    assert (
        "left, カメラ右: no room"
        in judge(replace(one, images=(), missing=(replace(gone[0], camera="left"), *gone))).headline
    )
    absent = AbsentCamera(name="Bohm", reason="lost 5 s before", label="Böhm")
    lacking = replace(one, burst=replace(one.burst, absent=(absent,)))
    assert "Böhm missing: lost 5 s before" in judge(lacking).headline
    assert judge(replace(lacking, images=(), missing=())).headline == "not taken: Böhm: lost 5 s before"
    skipped = SkippedInstant(
        leader_ns=0,
        missing=(
            SkippedFrame(camera="right", reason="", dropped=True),
            SkippedFrame(camera="x", reason="late"),
        ),
    )
    assert skipped_text((skipped,), one.labels) == "1 instant skipped: カメラ右 dropped 1 frame, x: late"
    hall, unsure = measured("hall", ""), measured("right", "hall")
    called = [replace(one, facts=replace(one.facts, label=f"カメラ {one.name}")) for one in (hall, unsure)]
    assert judge(take_of(*called)).stamps.startswith(
        "stamp error of カメラ right not measured except against カメラ hall"
    )
