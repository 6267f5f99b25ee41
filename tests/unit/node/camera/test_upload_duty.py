"""What a node and its leader owe each other of a burst, in histories that are drawn, without a stream.

Nothing is lost that is not reported as missing, nothing is sent twice, what was decided stays, a leader that
cannot take a burst is asked ever less often, each batch is within its bounds, and what the leader was told
last is so.
"""

import hashlib
from collections import deque
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from capture_app.node.camera import burst_upload as rules
from capture_app.node.camera.burst_upload import Upload, UploadInput, UploadState, encode_frame
from capture_app.protocol.messages import CameraReport, ImageUpload
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import WidenedTimes
from tests.histories import histories
from tests.unit.node.camera.uploading import Picture, burst_upload, further

DATA = [b"picture %02d" % n * (3 if n == 4 else 1) for n in range(12)]
FRAMES = [*burst_upload(*map(Picture, DATA)).frames]
BYTES = [hashlib.sha256(data).hexdigest() for data in DATA]
OTHER = "0" * 64
MAX_IMAGES, MAX_BYTES = 3, 25
"""Bounds of a batch here: two pictures."""
MAX_WAITING_BYTES = 55
"""Room in the memory of a node of a streamed burst: five pictures, or one that is large, and two."""
DELAY_S = 2
"""Pause before a burst is reported again that the leader could not take."""


class Film:
    """A burst's images in a spool without a disk."""

    def __init__(self) -> None:
        self.film = self
        self.data: dict[int, bytes] = {}
        self.images: dict[int, ImageUpload] = {}
        self.released: list[int] = []
        self.report: CameraReport | None = None

    def read(self, images: Sequence[ImageUpload]) -> list[bytes | None]:
        return [self.data.get(image.record.instant) for image in images]

    def release(self, instants: Collection[int]) -> list[Path]:
        for instant in instants:
            if self.data.pop(instant, None) is not None:
                self.released.append(instant)
                del self.images[instant]
        return []

    def recover(self) -> list[ImageUpload]:
        return [*self.images.values()]

    def read_report(self) -> CameraReport:
        assert self.report is not None
        return self.report


class Duty:
    """A node with one burst, and its leader; each method is something that happens."""

    def __init__(self, streamed: bool, requested: frozenset[int] | None) -> None:
        self.node, self.film = burst_upload(), Film()
        self.streamed, self.film.report = streamed, self.node.report
        self.node.streamed, self.node.spooled = streamed, cast(Any, self.film)
        self.node.max_bytes = MAX_WAITING_BYTES
        self.commits = 0
        self.node.on_commit = self._note_commit
        self.requested = None if streamed else requested
        self.end_instant = len(FRAMES) if streamed else None
        """Number of instants of a streamed burst that its operator wants."""
        self.told_end: int | None = None
        self.unwanted = set[int]()
        """Instants that the leader has told the node not to send."""
        self.now_s = 0.0
        self.due_s: float | None = None
        self.widened: list[WidenedTimes] = []
        self.reported: CameraPlan | None = None
        """The plan that the leader was told last."""
        self.damaged: set[int] = set()
        """Instants whose images the node has lost, as far as is known here."""
        self.gaps: set[int] = set()
        """Instants without a frame, by the camera."""
        self.is_cancelled = self.is_closed = False
        """Closed: no further frames are taken."""
        self.picked = 0
        """Number of instants that the camera has seen of a streamed burst."""
        self.restarted: set[int] = set()
        """Instants from before the node was killed, of which it does not know what it took."""
        self.stored: dict[int, str] = {}
        """Images that the leader has, by instant."""
        self.confirmed: set[int] = set()
        """Instants of which the node was told so."""
        self.in_flight: deque[tuple[list[ImageUpload], list[bytes]]] = deque()
        self.selected: set[int] = set()
        """Instants whose frames the node took."""
        self.next, self.is_full, self.is_asked, self.put_off_in_a_row = 0, False, False, 0
        self.decided: tuple[int, ...] | None = None
        """Instants that the node announced when the leader named those it needs."""

    # At the camera

    def select(self, number: int) -> None:
        """The camera delivers a frame or two, or drops it."""
        if self.next == len(FRAMES):
            return
        instants = range(self.next, min(len(FRAMES), self.next + (2 if number == 1 else 1)))
        self.next, is_dropped = instants.stop, number == 0
        waiting = sum(frame.frame.picture.held_bytes for frame in self.node.frames)
        waiting += sum(map(len, self.node.in_memory.values()))
        is_taken = not (self.is_closed or self.is_cancelled)
        self.picked = self.next if is_taken else self.picked
        gaps = instants if is_dropped else ()
        self.node.extend(further(*(FRAMES[n] for n in instants if not gaps), gaps=gaps, over=self.next))
        for instant in instants if is_taken else ():
            is_wanted = self.told_end is None or instant < self.told_end
            is_full = self.streamed and waiting + len(DATA[instant]) > MAX_WAITING_BYTES
            if is_dropped or (is_wanted and is_full):
                self.gaps.add(instant)
            elif is_wanted:
                self.selected.add(instant)
                waiting += len(DATA[instant])

    def select_late(self, number: int) -> None:
        """A selection of earlier instants comes after later ones."""
        if self.node.streamed:
            over = self.node.over
            self.node.extend(further(over=min(number, self.next)))
            assert self.node.over == over, "a decision was taken back"

    def end(self, _: int) -> None:
        """The selection ends, and what comes after it counts no more."""
        if self.node.streamed and not self.node.ended and not self.is_cancelled:
            self.node.extend(further(over=self.next, ended=True))
            self.is_closed = True
            before = self.node.current_report().plan
            self.node.extend(further(*FRAMES[self.next :], over=len(FRAMES)))
            assert self.node.current_report().plan == before
            self.next = len(FRAMES)

    def encode(self, number: int) -> None:
        if self.node.frames:
            picked = self.node.frames.popleft()
            image, data = encode_frame(self.node.report, picked)
            self.node.images[picked.instant] = image
            if number == 5:
                self.node.in_memory[picked.instant] = data
            else:
                self.film.data[picked.instant], self.film.images[picked.instant] = data, image
                self.node.unsynced[picked.instant] = image

    def damage(self, number: int) -> None:
        """The node's disk changes an image."""
        if self.film.data:
            instant = [*self.film.data][number % len(self.film.data)]
            self.film.data[instant] = b"changed"
            self.damaged.add(instant)

    def widen(self, number: int) -> None:
        """The node's clock was wrong for a while."""
        if self.node.state is UploadState.OVER:
            return
        times = WidenedTimes(
            from_local_ns=number, until_local_ns=number + 1, uncertainty_ns=5, hard_bound_ns=9, reason="step"
        )
        self.widened.append(times)
        self.node.widen_times(times)

    def cancel(self, number: int) -> None:
        """The operator cancels it."""
        if number == 0 and not self.is_cancelled:
            self.is_cancelled = True
            self.node.end()
            self.in_flight.clear()
            self.is_asked = False
            assert self.node.has_ended
            disputed = {image.record.instant for image in self.node.disputed}
            assert {*self.film.data} <= disputed
            self.check()

    def restart(self, _: int) -> None:
        """The node is killed, and goes on with what its spool has."""
        if self.is_cancelled or not self.film.images:
            return
        self.film.report = self.node.current_report()
        lost = {frame.instant for frame in self.node.frames} | {*self.node.in_memory}
        self.selected -= lost
        self.damaged |= lost
        self.break_off(0)
        self.restarted |= {*range(self.next)}
        left, kept = Upload.of_spool(cast(Any, self.film)), self.node
        if self.node.streamed and not self.is_closed:
            self.node = burst_upload()
            self.node.streamed, self.node.max_bytes = True, kept.max_bytes
            self.node.continue_from(left)
            self.node.extend(further(gaps=range(self.next), over=self.next))
            self.told_end, self.widened = None, []
        else:
            self.node, self.is_closed = left, True
            self.next = len(FRAMES)
        self.node.on_commit = self._note_commit
        self.confirmed -= {*self.node.images}

    # Between the two

    def _note_commit(self) -> None:
        self.commits += 1

    def ask(self, _: int) -> None:
        must = self.node.must_be_reported(self.now_s)
        if self.due_s is not None and self.node.state is UploadState.WAITING:
            assert must == (self.now_s >= self.due_s), "it asks too early, or not at all"
        if not self.is_asked and must:
            while self.in_flight:
                self.answer(0)
        if not self.is_asked and self.node.must_be_reported(self.now_s):
            self.reported = self.node.current_report(
                (*self.node.images, *(frame.instant for frame in self.node.frames))
            ).plan
            if not self.node.streamed:
                told = {*self.reported.instants, *(gap.instant for gap in self.reported.missing)}
                assert self.selected <= told, "the leader does not learn of it"
            self.node.take(UploadInput.REPORTED)
            self.is_asked = True

    def wait(self, _: int) -> None:
        self.now_s += DELAY_S / 2

    def told(self, _: int) -> None:
        """The leader answers a report."""
        if not self.is_asked:
            return
        self.is_asked = False
        if self.is_full:
            self._put_off()
            return
        commits, before = self.commits, {*self.node.images}
        self.node.commit(self.requested, self.end_instant)
        self.told_end = self.end_instant
        if self.requested is not None:
            self.unwanted |= {*range(len(FRAMES))} - self.requested
        assert (self.commits > commits) is not self.node.streamed, "it selects on, or no longer"
        assert {*self.node.images} <= before
        self._confirm(self.stored)
        # Of an instant that the node has not encoded yet it only learns when it is sent.
        self.confirmed |= {instant for instant, sha256 in self.stored.items() if sha256 == BYTES[instant]}
        if lost := self.node.lost_instants():
            assert self.damaged.issuperset(lost), "it is here, and said to be lost"
            self.node.report_lost(lost, "lost")
        if self.decided is None and not self.node.streamed and self.node.state is UploadState.SENDING:
            self.decided, self.is_closed = self.node.report.plan.instants, True

    def send(self, _: int) -> None:
        sent = sum(len(images) for images, _ in self.in_flight)
        if self.is_asked or self.node.state is not UploadState.SENDING or sent >= len(self.node.images):
            return
        images = self.node.next_batch(sent)
        loaded = self.node.load(images)
        if lost := [image.record.instant for image, data in zip(images, loaded, strict=True) if data is None]:
            assert self.damaged.issuperset(lost), "it is whole, and said to be lost"
            self.node.report_lost(lost, "damaged")
            return
        assert len(images) <= MAX_IMAGES
        after = [*self.node.images.values()][sent + len(images) :]
        is_full = len(images) == MAX_IMAGES or sum(image.bytes for image in (*images, *after[:1])) > MAX_BYTES
        assert is_full or not after, "it sends its images one by one"
        assert len(images) == 1 or sum(image.bytes for image in images) <= MAX_BYTES
        numbers = {image.record.instant for image in images}
        under_way = {image.record.instant for batch, _ in self.in_flight for image in batch}
        assert not numbers & under_way, "it is on its way"
        assert not numbers & self.confirmed, "the node knows that the leader has it"
        assert self.requested is None or numbers <= self.requested, "nobody has asked for it"
        assert self.told_end is None or max(numbers) < self.told_end, "nobody wants it any more"
        whole = [data for data in loaded if data is not None]
        for instant, data in zip(sorted(numbers), whole, strict=True):
            assert data in (DATA[instant], b"changed"), "it is another image"
        if self.node.is_doubted or not self.node.streamed:
            assert b"changed" not in whole, "it is in doubt, and was not checked"
        self.in_flight.append((images, whole))

    def answer(self, _: int) -> None:
        """The leader answers to a batch; after a refusal, to all others before the node does anything."""
        if not self.in_flight:
            return
        images, data = self.in_flight.popleft()
        sha256 = {image.record.instant: hashlib.sha256(of) for image, of in zip(images, data, strict=True)}
        is_other = any(
            self.stored.get(image.record.instant, image.sha256) != image.sha256
            or sha256[image.record.instant].hexdigest() != image.sha256
            for image in images
        )
        if self.is_full or is_other:
            while self.in_flight:
                self.answer(0)
            self._put_off()
            return
        stored = {image.record.instant: image.sha256 for image in images}
        self.stored |= stored
        self.confirmed |= {*stored}
        self._confirm(stored)

    def _confirm(self, stored: dict[int, str]) -> None:
        taken = {
            instant for instant, image in self.node.images.items() if stored.get(instant) == image.sha256
        }
        if taken:
            self.put_off_in_a_row = 0
        self.node.confirm(stored)

    def _put_off(self) -> None:
        self.due_s = self.now_s + DELAY_S
        self.node.put_off(self.due_s)
        self.put_off_in_a_row += 1
        assert self.node.attempts == self.put_off_in_a_row, "pauses do not grow"

    def break_off(self, _: int) -> None:
        """The stream breaks off; the leader may have saved what was on its way."""
        for images, data in self.in_flight:
            for image, of in zip(images, data, strict=True):
                if not self.is_full and hashlib.sha256(of).hexdigest() == image.sha256:
                    self.stored.setdefault(image.record.instant, image.sha256)
        self.in_flight.clear()
        self.is_asked, self.put_off_in_a_row = False, 0
        disputed = {image.record.instant for image in self.node.disputed}
        self.node.reopen()
        assert not self.node.disputed
        assert disputed <= {*self.node.images}, "another leader may take it"
        self.confirmed -= {*self.node.images}

    # At the leader

    def cut(self, number: int) -> None:
        """The operator ends a streamed burst earlier than was ordered."""
        if self.end_instant is not None:
            self.end_instant = min(self.end_instant, max(1, 2 * number))

    def fill(self, number: int) -> None:
        self.is_full = number < 3

    def save_other(self, number: int) -> None:
        """The leader has another image in an instant's place, as of a camera of the same name."""
        if number not in self.confirmed:
            self.stored.setdefault(number, OTHER)

    def check(self) -> None:
        if self.is_cancelled:
            assert not [*self.node.frames, *self.node.images], "it takes what nobody wants"
            return
        node, plan = self.node, self.node.report.plan
        disputed = [image.record.instant for image in node.disputed]
        assert len({*disputed, *node.images}) == len(disputed) + len(node.images), "one image is twice here"
        missing = {gap.instant for gap in plan.missing} | {
            instant
            for run in (*node.missing_runs, *plan.missing_runs)
            for instant in range(run.first, run.first + run.count)
        }
        here = {*node.images, *disputed, *(frame.instant for frame in node.frames)}
        at_leader = {instant for instant, sha256 in self.stored.items() if sha256 == BYTES[instant]}
        unwanted = {*self.unwanted}
        if self.told_end is not None:
            unwanted |= {*range(self.told_end, len(FRAMES))}
        assert self.gaps <= missing, "nobody is told of a gap"
        assert not missing & here - self.restarted, "it is here, and said to be missing"
        if node.has_ended:
            assert not [*node.frames, *node.images], "it has more to send"
            assert self.is_closed or not node.streamed, "its camera selects on"
        assert {*node.in_memory, *node.unsynced} <= {*node.images, *disputed}, "it stays for ever"
        assert self.selected <= here | at_leader | missing | unwanted, "frames are lost, and nobody is told"
        stored = {*self.film.data, *node.in_memory}
        assert {*node.images, *disputed} <= stored, "it is deleted, and is to be sent"
        assert {*self.film.released} <= at_leader | missing | unwanted, "it was deleted, and nobody has it"
        if self.decided is not None:
            assert {*plan.instants} <= {*self.decided}, "a decision was taken back"

    def finish(self) -> None:
        """Let the leader have room again, until nothing more is sent."""
        self.is_full = False
        for _ in range(12 * len(FRAMES)):
            self.end(0)
            self.encode(0)
            self.wait(0)
            self.ask(0)
            self.told(0)
            self.send(0)
            self.answer(0)
            self.check()
            if self.node.has_ended and not self.in_flight:
                break
        assert self.node.has_ended, f"it goes on for ever: {self.node.state}"
        assert not self.node.images
        if self.reported is not None and not self.is_cancelled:
            assert self.reported.camera.widened == tuple(self.widened), (
                "the leader takes wrong times for right"
            )
            assert not self.reported.picking
            if self.node.streamed:
                assert (self.reported.picked, self.reported.missing_runs) == (
                    self.picked, tuple(self.node.missing_runs)
                )  # fmt: skip
            else:
                assert self.reported == self.node.report.plan


USUAL = ("select", "select", "encode", "encode", "ask", "told", "send", "send", "answer", "wait", "break_off")
"""What makes a burst go on."""
OTHERS = (
    *("select_late", "end", "damage", "fill", "save_other"),
    *("widen", "cancel", "restart", "cut"),
)


@pytest.fixture(scope="module", autouse=True)
def small_batches() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rules, "BATCH_BYTES", MAX_BYTES)
        patch.setattr(rules, "MAX_BATCH_IMAGES", MAX_IMAGES)
        yield


@pytest.mark.parametrize("streamed", [False, True])
@given(histories(USUAL, OTHERS, max_steps=60, max_others=4), st.none() | st.frozensets(st.integers(0, 11)))
@example([("ask", 0), ("told", 0), ("break_off", 0), ("select", 1)], None)
def test_nothing_is_lost_sent_twice_or_taken_back(
    streamed: bool, history: list[tuple[str, int]], requested: frozenset[int] | None
) -> None:
    duty = Duty(streamed, requested)
    for step, number in history:
        getattr(duty, step)(number)
        duty.check()
    duty.finish()
