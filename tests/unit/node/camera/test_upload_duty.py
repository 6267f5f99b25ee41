"""What a node and its leader owe each other of a burst, in histories that are drawn, without a stream.

Nothing is lost that is not reported as missing, nothing is sent twice, what was decided stays, a leader that
cannot take a burst is asked ever less often, and each batch is within its bounds.
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
from capture_app.node.camera.burst_upload import UploadInput, UploadState, encode_frame
from capture_app.protocol.messages import ImageUpload
from tests.histories import histories
from tests.unit.node.camera.uploading import Picture, burst_upload, further

FRAMES = [*burst_upload(*(Picture(b"picture %02d" % n) for n in range(12))).frames]
BYTES = [hashlib.sha256(b"picture %02d" % n).hexdigest() for n in range(12)]
OTHER = "0" * 64
MAX_IMAGES, MAX_BYTES = 3, 25
"""Bounds of a batch here: two pictures."""


class Film:
    """A burst's images in a spool without a disk."""

    def __init__(self) -> None:
        self.film = self
        self.data: dict[int, bytes] = {}
        self.released: list[int] = []

    def read(self, images: Sequence[ImageUpload]) -> list[bytes | None]:
        return [self.data.get(image.record.instant) for image in images]

    def release(self, instants: Collection[int]) -> list[Path]:
        for instant in instants:
            if self.data.pop(instant, None) is not None:
                self.released.append(instant)
        return []


class Duty:
    """A node with one burst, and its leader; each method is something that happens."""

    def __init__(self, streamed: bool, requested: frozenset[int] | None) -> None:
        self.node, self.film = burst_upload(), Film()
        self.node.streamed, self.node.spooled = streamed, cast(Any, self.film)
        self.requested = None if streamed else requested
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
        """The camera delivers a frame, or drops it."""
        if self.next == len(FRAMES):
            return
        before = self._announced()
        picked = [] if number == 0 else [FRAMES[self.next]]
        gaps = [self.next] if number == 0 else []
        self.next += 1
        self.node.extend(further(*picked, gaps=gaps, over=self.next))
        self.selected |= {*self._announced()} - {*before}

    def select_late(self, number: int) -> None:
        """A selection of earlier instants comes after later ones."""
        if self.node.streamed:
            over = self.node.over
            self.node.extend(further(over=min(number, self.next)))
            assert self.node.over == over, "a decision was taken back"

    def end(self, _: int) -> None:
        """The selection ends, and what comes after it counts no more."""
        if self.node.streamed and not self.node.ended:
            self.node.extend(further(over=self.next, ended=True))
            before = self.node.current_report().plan
            self.node.extend(further(*FRAMES[self.next :], over=len(FRAMES)))
            assert self.node.current_report().plan == before
            self.next = len(FRAMES)

    def encode(self, _: int) -> None:
        if self.node.frames:
            picked = self.node.frames.popleft()
            image, data = encode_frame(self.node.report, picked)
            self.film.data[picked.instant], self.node.images[picked.instant] = data, image

    def damage(self, number: int) -> None:
        """The node's disk changes an image."""
        if self.film.data:
            instant = [*self.film.data][number % len(self.film.data)]
            self.film.data[instant] = b"changed"

    # Between the two

    def ask(self, now_s: float = 1e9) -> None:
        if not self.is_asked and self.node.must_be_reported(now_s):
            while self.in_flight:
                self.answer(0)
        if not self.is_asked and self.node.must_be_reported(now_s):
            self.node.take(UploadInput.REPORTED)
            self.is_asked = True

    def told(self, _: int) -> None:
        """The leader answers a report."""
        if not self.is_asked:
            return
        self.is_asked = False
        if self.is_full:
            self._put_off()
            return
        self.node.commit(self.requested)
        self._confirm(self.stored)
        # Of an instant that the node has not encoded yet it only learns when it is sent.
        self.confirmed |= {instant for instant, sha256 in self.stored.items() if sha256 == BYTES[instant]}
        if lost := self.node.lost_instants():
            self.node.report_lost(lost, "lost")
        if self.decided is None and not self.node.streamed and self.node.state is UploadState.SENDING:
            self.decided = self.node.report.plan.instants

    def send(self, _: int) -> None:
        sent = sum(len(images) for images, _ in self.in_flight)
        if self.is_asked or self.node.state is not UploadState.SENDING or sent >= len(self.node.images):
            return
        images = self.node.next_batch(sent)
        loaded = self.node.load(images)
        if lost := [image.record.instant for image, data in zip(images, loaded, strict=True) if data is None]:
            self.node.report_lost(lost, "damaged")
            return
        assert len(images) <= MAX_IMAGES
        assert len(images) == 1 or sum(image.bytes for image in images) <= MAX_BYTES
        numbers = {image.record.instant for image in images}
        under_way = {image.record.instant for batch, _ in self.in_flight for image in batch}
        assert not numbers & under_way, "it is on its way"
        assert not numbers & self.confirmed, "the node knows that the leader has it"
        assert self.requested is None or numbers <= self.requested, "nobody has asked for it"
        whole = [data for data in loaded if data is not None]
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
        self.node.put_off(0.0)
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
        self.node.reopen()
        self.confirmed -= {*self.node.images}

    # At the leader

    def fill(self, number: int) -> None:
        self.is_full = number == 0

    def save_other(self, number: int) -> None:
        """The leader has another image in an instant's place, as of a camera of the same name."""
        if number not in self.confirmed:
            self.stored.setdefault(number, OTHER)

    def check(self) -> None:
        node, plan = self.node, self.node.report.plan
        disputed = [image.record.instant for image in node.disputed]
        assert len({*disputed, *node.images}) == len(disputed) + len(node.images), "one image is twice here"
        missing = {gap.instant for gap in plan.missing} | {
            instant for run in node.missing_runs for instant in range(run.first, run.first + run.count)
        }
        here = {*node.images, *disputed, *(frame.instant for frame in node.frames)}
        at_leader = {instant for instant, sha256 in self.stored.items() if sha256 == BYTES[instant]}
        unwanted = {*range(len(FRAMES))} - node.requested if node.requested is not None else set[int]()
        assert self.selected <= here | at_leader | missing | unwanted, "frames are lost, and nobody is told"
        assert {*node.images, *disputed} <= {*self.film.data}, "it is deleted, and is to be sent"
        assert {*self.film.released} <= at_leader | missing | unwanted, "it was deleted, and nobody has it"
        if self.decided is not None:
            assert {*plan.instants} <= {*self.decided}, "a decision was taken back"

    def finish(self) -> None:
        """Let the leader have room again, until nothing more is sent."""
        self.is_full = False
        for _ in range(12 * len(FRAMES)):
            self.end(0)
            self.encode(0)
            self.ask()
            self.told(0)
            self.send(0)
            self.answer(0)
            self.check()
            if self.node.has_ended and not self.in_flight:
                break
        assert self.node.has_ended, f"it goes on for ever: {self.node.state}"
        assert not self.node.images

    def _announced(self) -> tuple[int, ...]:
        if self.node.streamed:
            return tuple(frame.instant for frame in self.node.frames)
        return self.node.report.plan.instants


USUAL = ("select", "select", "encode", "encode", "ask", "told", "send", "send", "answer")
"""What makes a burst go on."""
OTHERS = ("select_late", "end", "damage", "break_off", "fill", "save_other")


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
