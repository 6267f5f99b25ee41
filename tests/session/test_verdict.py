"""What a take is good for, by its times and by what is missing."""

import pytest
from msgspec.structs import replace

from capture_app.session.format.manifest import BurstRecord, ImageRecord, Manifest, MissingImage
from capture_app.session.reading.synchronization import sync_record
from capture_app.session.reading.verdict import GRADE_LIMITS, Grade, describe_displacement, grade_of, judge

from .conftest import camera_record

MS, US = 1_000_000, 1_000
BURST = BurstRecord(instants_ns=(0, 33 * MS), period_ns=33 * MS)
CAMERAS = (camera_record("left"), camera_record("right"))


def image(
    camera: str, instant: int, late_ns: int, error_ns: int | None = 10 * US, **more: object
) -> ImageRecord:
    """An image so much after its instant."""
    leader_ns = BURST.instants_ns[instant] + late_ns
    place = {"camera": camera, "instant": instant, "leader_ns": leader_ns, "path": "x", "bytes": 1}
    return ImageRecord(sha256="0" * 64, uncertainty_ns=error_ns, **{**place, **more})


def take(*images: ImageRecord, missing: tuple[MissingImage, ...] = ()) -> Manifest:
    """A take of two cameras and two instants."""
    about = {"name": "take", "created": "2026-01-01T00:00:00Z", "origin": "captured", "software": "test"}
    return Manifest(cameras=CAMERAS, burst=BURST, images=images, missing=missing, **about)


@pytest.mark.parametrize(
    ("spread_ns", "grade"),
    [(60 * US, Grade.EXCELLENT), (700 * US, Grade.GOOD), (5 * MS, Grade.FAIR), (16 * MS, Grade.POOR)],
)
def test_the_grade_is_by_the_spread_with_the_clocks_error(spread_ns: int, grade: Grade) -> None:
    verdict = judge(take(image("left", 0, 0), image("right", 0, spread_ns), image("left", 1, 0)))
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


def test_the_grades_are_explained_by_the_limits_that_hold() -> None:
    limits = (100 * US, 1 * MS, 10 * MS)
    assert GRADE_LIMITS == (
        "spread and error together: excellent below 100 µs, good below 1.0 ms, fair below 10 ms"
    )
    graded = [(grade_of(limit - 1 - US, US)[0], grade_of(limit, US)[0]) for limit in limits]
    assert graded == [
        (Grade.EXCELLENT, Grade.GOOD),
        (Grade.GOOD, Grade.FAIR),
        (Grade.FAIR, Grade.POOR),
    ]


def test_what_cannot_be_judged_is_unknown() -> None:
    unsure = judge(take(image("left", 0, 0, None), image("right", 0, 63 * US)))
    assert unsure.grade is Grade.UNKNOWN
    assert "not measured: 63 µs apart by the recorded times, whose error is not known" in unsure.headline
    assert unsure.spread == "63 µs"
    alone = judge(take(image("left", 0, 0), image("right", 1, 0)))
    assert alone.grade is Grade.UNKNOWN
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
