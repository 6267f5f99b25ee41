"""The states of a burst on its way to the leader, and what happens in each of them."""

from itertools import product

import pytest

from capture_app.node.camera.burst_upload import TRANSITIONS, Upload, UploadInput, UploadState
from capture_app.session.format.manifest import MAX_WIDENED, WidenedTimes
from tests.unit.node.camera.uploading import Picture, burst_upload

LATER_S = 10.0
IMPOSSIBLE = {
    # No answer comes before a report is sent.
    *product([UploadState.UNREPORTED], [UploadInput.PUT_OFF, UploadInput.REQUESTED, UploadInput.REFUSED]),
    # A report is sent where none is awaited or needed, and the leader names instants in answer to it only.
    (UploadState.ASKED, UploadInput.REPORTED),
    *product([UploadState.SENDING], [UploadInput.REPORTED, UploadInput.REQUESTED]),
    (UploadState.WAITING, UploadInput.REQUESTED),
    # Nothing is sent of a burst that was refused.
    *product(
        [UploadState.REFUSED],
        [UploadInput.REPORTED, UploadInput.PUT_OFF, UploadInput.REQUESTED, UploadInput.REFUSED],
    ),
}


def after(*events: UploadInput) -> Upload:
    """Return a burst of one frame after these inputs."""
    upload = burst_upload(Picture(b"zero"))
    for event in events:
        upload.take(event)
    return upload


def test_each_input_has_its_row_in_each_state_or_is_impossible_there() -> None:
    assert {*product(UploadState, UploadInput)} - {*TRANSITIONS} == IMPOSSIBLE
    with pytest.raises(KeyError):
        after(UploadInput.REQUESTED)


def test_a_report_that_changes_while_its_answer_is_awaited_is_sent_again() -> None:
    upload = after(UploadInput.REPORTED)
    assert not upload.must_be_reported(0.0)
    upload.report_lost([0], "its file in the spool is damaged")
    upload.commit(None)
    assert upload.must_be_reported(0.0)
    assert not upload.has_ended
    upload.take(UploadInput.REPORTED)
    upload.commit(None)
    assert not upload.must_be_reported(LATER_S)


def test_a_burst_that_is_put_off_is_reported_when_it_is_due_or_changes() -> None:
    upload = after(UploadInput.REPORTED)
    upload.put_off(LATER_S)
    assert [upload.must_be_reported(now_s) for now_s in (0.0, LATER_S)] == [False, True]
    upload.stop_selecting()
    assert upload.must_be_reported(0.0)


@pytest.mark.parametrize("event", UploadInput)
def test_nothing_is_sent_of_a_burst_that_is_over(event: UploadInput) -> None:
    upload = after(UploadInput.REPORTED)
    upload.end()
    upload.take(event)
    assert upload.has_ended
    assert not upload.must_be_reported(LATER_S)


def test_a_refused_burst_is_offered_to_another_leader_only() -> None:
    upload = after(UploadInput.REPORTED, UploadInput.REFUSED, UploadInput.CHANGED)
    assert not upload.must_be_reported(LATER_S)
    assert not upload.has_ended
    upload.reopen()
    assert upload.must_be_reported(0.0)


def test_times_found_to_be_wrong_too_often_are_wrong_from_the_last_such_time_on() -> None:
    upload = burst_upload(Picture(b"zero"))
    for n in range(MAX_WIDENED + 2):
        spell = {"from_local_ns": 10 * n, "until_local_ns": 10 * n + 5, "uncertainty_ns": 100 - n}
        upload.widen_times(WidenedTimes(**spell, hard_bound_ns=200 + n, reason="the clock was stepped"))
    spells = upload.report.plan.camera.widened
    assert len(spells) == MAX_WIDENED
    last = spells[-1]
    assert (last.from_local_ns, last.until_local_ns) == (10 * (MAX_WIDENED - 1), 10 * (MAX_WIDENED + 1) + 5)
    assert (last.uncertainty_ns, last.hard_bound_ns) == (101 - MAX_WIDENED, 201 + MAX_WIDENED)
