"""One burst on its node: what is kept, offered again, sent and dropped, without a stream."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.cameras.frames import CapturedFrame
from capture_app.node.camera.burst_upload import (
    BATCH_BYTES,
    Upload,
    UploadInput,
    UploadState,
    encode_frame,
)
from capture_app.node.camera.spool import Spool, SpoolFolder
from capture_app.protocol.messages import MAX_BATCH_IMAGES, ImageUpload
from capture_app.sync.rig.frame_selection import SelectedFrame
from tests.unit.node.camera.uploading import CAMERA, Picture, burst_upload, further

DATA = [b"picture %d" % n for n in range(6)]
FRAMES = [*burst_upload(*map(Picture, DATA)).frames]


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    spool = Spool(tmp_path, "a")
    spool.open()
    yield spool
    spool.close()


def spooled_upload(spool: Spool, *instants: int, streamed: bool = False) -> Upload:
    """A burst with these images in the spool, as they are after they were encoded."""
    upload = burst_upload()
    upload.streamed = streamed
    upload.change_report(instants=tuple(instants))
    upload.spooled = spool.create_burst(upload.report)
    images = [encode_frame(upload.report, FRAMES[instant]) for instant in instants]
    upload.spooled.add(images)
    upload.images |= {image.record.instant: image for image, _ in images}
    return upload


def sending(upload: Upload) -> Upload:
    """Let the leader request all of a burst."""
    upload.take(UploadInput.REPORTED)
    upload.commit(None)
    return upload


def offered(upload: Upload) -> list[int]:
    """Return the instants whose images are sent."""
    return [image.record.instant for image in upload.next_batch(0)]


def receipt(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize(
    ("plan", "announced"),
    [
        # An image that was announced, and is not there, is reported as lost.
        ({"instants": (0, 1, 2)}, (0, 1, 2)),
        # The leader has what is no longer here of a film: it is not announced again.
        ({"instants": (0, 1, 2), "picked": 3}, (0, 2)),
        ({"instants": (0, 1, 2), "picking": True}, (0, 2)),
    ],
)
def test_what_is_announced_of_a_burst_that_an_earlier_run_left(
    spool: Spool, plan: dict[str, object], announced: tuple[int, ...]
) -> None:
    left = spooled_upload(spool, 0, 2)
    assert left.spooled is not None
    left.spooled.write_report(left.report.with_plan(**plan))
    again = Upload.of_spool(SpoolFolder(left.spooled.folder))
    assert again.report.plan.instants == announced
    assert [*again.images] == [0, 2]
    assert not again.report.plan.picking


def continued(upload: Upload) -> Upload:
    again = burst_upload()
    again.streamed = True
    again.continue_from(upload)
    return again


def refused(upload: Upload) -> Upload:
    sending(upload).put_off(0.0)
    return upload


@pytest.mark.parametrize(
    ("streamed", "doubt", "is_checked"),
    [
        (False, sending, True),
        (True, sending, False),
        (True, refused, True),
        (True, continued, True),
    ],
)
def test_the_bytes_of_a_burst_in_doubt_are_checked_before_they_are_sent(
    spool: Spool, streamed: bool, doubt: Callable[[Upload], Upload], is_checked: bool
) -> None:
    upload = doubt(spooled_upload(spool, 0, 1, streamed=streamed))
    assert upload.spooled is not None
    film = upload.spooled.folder / "000001.film"
    film.write_bytes(film.read_bytes().replace(DATA[1], b"otherness"))
    assert upload.load([*upload.images.values()]) == [DATA[0], None if is_checked else b"otherness"]


def test_frames_that_are_selected_after_the_leader_has_decided_are_not_taken() -> None:
    upload = burst_upload(*map(Picture, DATA[:2]))
    upload.take(UploadInput.REPORTED)
    upload.commit([0])
    before = upload.report
    upload.extend(further(FRAMES[2], gaps=(3,)))
    assert (upload.report, upload.state) == (before, UploadState.SENDING)
    assert [frame.instant for frame in upload.frames] == [0]


def test_an_image_in_whose_place_the_leader_has_another_is_kept_and_offered_to_the_next(spool: Spool) -> None:
    upload = sending(spooled_upload(spool, 0, 1))
    image = upload.images[0]
    for _ in range(2):
        upload.confirm({0: receipt(b"another"), 1: receipt(DATA[1])})
        assert (offered(upload), upload.disputed) == ([], [image])
        assert upload.load([image]) == [DATA[0]], "it is not deleted"
        upload.reopen()
        assert (offered(upload), upload.disputed) == ([0], [])
    # That leader has no other image there.
    upload.confirm({0: receipt(DATA[0])})
    upload.reopen()
    assert offered(upload) == []


def test_what_the_leader_has_is_neither_kept_nor_offered_again(spool: Spool) -> None:
    upload = sending(spooled_upload(spool, 0, 1, 2))
    image = upload.images[1]
    upload.unsynced.update(upload.images)
    upload.in_memory.update(enumerate(DATA[:3]))
    upload.confirm({1: receipt(DATA[1])})
    assert offered(upload) == [0, 2]
    assert [*upload.unsynced] == [*upload.in_memory] == [0, 2]
    assert upload.load([image]) == [None]
    upload.reopen()
    assert offered(sending(upload)) == [0, 2]
    assert upload.lost_instants() == [], "the leader has it"


def test_pauses_are_counted_until_an_image_is_saved_or_a_stream_is_opened(spool: Spool) -> None:
    upload = sending(spooled_upload(spool, 0, 1))
    attempts = []
    saved: dict[int, str]
    for saved in ({}, {}, {0: receipt(DATA[0])}, {0: receipt(DATA[0])}):
        upload.put_off(0.0)
        attempts.append(upload.attempts)
        upload.take(UploadInput.REPORTED)
        # The leader takes the report each time: what it cannot save is an image.
        upload.commit(None)
        upload.confirm(saved)
    upload.put_off(0.0)
    upload.reopen()
    assert (attempts, upload.attempts) == ([1, 2, 3, 1], 0)


def sized(*sizes: int) -> Upload:
    """A burst with encoded images of these sizes in bytes."""
    upload = burst_upload()
    image, _ = encode_frame(upload.report, FRAMES[0])
    for instant, size in enumerate(sizes):
        upload.images[instant] = sized_image(image, instant, size)
    return upload


def sized_image(image: ImageUpload, instant: int, size: int) -> ImageUpload:
    return replace(image, record=replace(image.record, instant=instant, bytes=size))


def batches(upload: Upload) -> list[list[int]]:
    """Return the instants of each batch, as they are sent."""
    numbers: list[list[int]] = []
    sent = 0
    while batch := upload.next_batch(sent):
        numbers.append([image.record.instant for image in batch])
        sent += len(batch)
    return numbers


def test_batches_are_within_their_bounds_and_a_large_image_is_one_of_its_own() -> None:
    half = BATCH_BYTES // 2
    assert batches(sized(half, half, 1, half, half, BATCH_BYTES, 2 * BATCH_BYTES, 1)) == [
        [0, 1], [2, 3], [4], [5], [6], [7],
    ]  # fmt: skip
    assert [*map(len, batches(sized(*[1] * (MAX_BATCH_IMAGES + 1))))] == [MAX_BATCH_IMAGES, 1]


def test_what_waits_in_memory_counts_with_the_frames_that_wait_to_be_encoded() -> None:
    upload = burst_upload()
    upload.streamed, upload.max_bytes = True, 3 * len(DATA[0])
    upload.in_memory[0] = DATA[0]
    upload.extend(further(*FRAMES[1:4], over=4))
    assert [frame.instant for frame in upload.frames] == [1, 2]
    assert [run.first for run in upload.missing_runs] == [3]


@pytest.mark.parametrize("streamed", [False, True])
def test_a_decision_ends_the_selection_of_a_burst_but_not_of_a_recording(streamed: bool) -> None:
    told: list[bool] = []
    upload = burst_upload()
    upload.streamed, upload.on_commit = streamed, lambda: told.append(True)
    sending(upload)
    assert bool(told) is not streamed


def test_a_header_has_its_frames_times_and_all_their_errors() -> None:
    """A phone's clock is another one than its node's: both are wrong by something."""
    frame = CapturedFrame(
        7, 2, 990, Picture(DATA[0]), exposure_ns=40, gain=1.5, true_ns=12, clock_uncertainty_ns=300
    )
    picked = SelectedFrame(3, 1_010, 2_010, -8, 50, 60, 9, frame, alignment_offset_ns=20)
    image, data = encode_frame(burst_upload().report, picked)
    record = image.record
    assert (record.camera, record.instant, record.sequence) == ("a", 3, 7)
    assert (record.local_ns, record.leader_ns, record.residual_ns) == (1_010, 2_010, -8)
    assert (record.uncertainty_ns, record.hard_bound_ns) == (50 + 300, 60)
    assert (record.outlier_ns, record.alignment_offset_ns, image.true_ns) == (9, 20, 12)
    # It begins where the timestamp says, not the moment that was aligned.
    assert record.exposure_start_ns == CAMERA.exposure_start_ns(2_010 - 20, 40)
    assert (record.exposure_ns, record.gain) == (40, 1.5)
    assert (record.bytes, record.sha256, data) == (len(DATA[0]), receipt(DATA[0]), DATA[0])
