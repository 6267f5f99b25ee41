"""When rows were exposed, how far apart the cameras are, and what that costs, in plain words."""

from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.camera_facts import TimestampSource
from capture_app.session.format.manifest import (
    BurstRecord,
    ImageRecord,
    MissingImage,
    row_exposures,
    sync_record,
)

from .conftest import HEIGHT, camera_record

MS, US = 1_000_000, 1_000


def image(camera: str, instant: int, leader_ns: int, **more: Any) -> ImageRecord:
    """An image whose bytes do not matter."""
    place: dict[str, Any] = {"camera": camera, "instant": instant, "leader_ns": leader_ns, "path": "x"}
    return ImageRecord(bytes=1, sha256="0" * 64, **{**place, **more})


def test_a_stamp_at_the_start_is_the_first_rows_start() -> None:
    camera = camera_record("left", row_time_ns=10 * US)
    assert camera.facts.exposure_start_ns(5 * MS, None) == 5 * MS


def test_a_stamp_at_the_end_is_later_by_exposure_and_readout() -> None:
    camera = camera_record("left", timestamp_source=TimestampSource.END_OF_FRAME, row_time_ns=10 * US)
    start_ns = camera.facts.exposure_start_ns(5 * MS, 2 * MS)
    assert start_ns == 5 * MS - 2 * MS - (HEIGHT - 1) * 10 * US
    rows = row_exposures(camera, image("left", 0, 5 * MS, exposure_start_ns=start_ns, exposure_ns=2 * MS))
    assert rows is not None
    assert rows.middle_ns(HEIGHT - 1) + 1 * MS == 5 * MS  # the last row ends with the frame
    assert rows.middle_ns(0) == start_ns + 1 * MS


@pytest.mark.parametrize(
    ("source", "exposure_ns", "row_time_ns"),
    [
        (TimestampSource.UNKNOWN, 1, 1),
        (TimestampSource.END_OF_FRAME, None, 1),
        (TimestampSource.END_OF_FRAME, 1, None),
    ],
)
def test_what_is_not_known_is_not_guessed(
    source: TimestampSource, exposure_ns: int | None, row_time_ns: int | None
) -> None:
    camera = camera_record("left", timestamp_source=source, row_time_ns=row_time_ns)
    assert camera.facts.exposure_start_ns(5 * MS, exposure_ns) is None
    assert row_exposures(camera, image("left", 0, 5 * MS, exposure_ns=exposure_ns)) is None


def test_the_record_counts_and_measures() -> None:
    cameras = [camera_record("left"), camera_record("right")]
    images = [
        image("left", 0, 100 * US, uncertainty_ns=10 * US, hard_bound_ns=1 * MS),
        image("right", 0, 130 * US, uncertainty_ns=20 * US, hard_bound_ns=2 * MS, late=True),
        image("left", 1, 33 * MS, uncertainty_ns=10 * US, hard_bound_ns=1 * MS, substitute=True),
    ]
    missing = [MissingImage(camera="right", instant=1, reason="?", dropped=True)]
    burst = BurstRecord(instants_ns=(0, 33 * MS), period_ns=33 * MS)
    sync = sync_record(cameras, burst, images, missing)
    assert sync.spread_ns == (30 * US, 0)
    assert (sync.uncertainty_ns, sync.hard_bound_ns) == (20 * US, 2 * MS)
    assert (sync.dropped, sync.substituted, sync.late) == (1, 1, 1)
    assert sync.row_spread_ns is None
    unsure = [*images[:2], replace(images[2], uncertainty_ns=None)]
    assert sync_record(cameras, burst, unsure, missing).uncertainty_ns is None


def test_rolling_shutters_that_differ_drift_apart_down_the_picture() -> None:
    cameras = [camera_record("left", row_time_ns=10 * US), camera_record("right", row_time_ns=12 * US)]
    images = [image(c.name, 0, 0, exposure_start_ns=0, exposure_ns=4 * MS) for c in cameras]
    sync = sync_record(cameras, BurstRecord(instants_ns=(0,), period_ns=33 * MS), images, [])
    assert sync.spread_ns == (0,)
    assert sync.row_spread_ns == (HEIGHT - 1) * 2 * US
