"""The way of what the engine has picked of a burst to the uploader."""

import functools
from collections import deque

from msgspec.structs import replace

from capture_app.cameras.base import CapturedFrame
from capture_app.clock import NodeClock
from capture_app.node.camera.records import (
    camera_record,
    camera_report,
    missing_images,
    true_clock,
    with_device_clock,
)
from capture_app.node.camera.supervisor import CameraSupervisor
from capture_app.node.transfer.burst_upload import BurstUpload
from capture_app.node.transfer.picked_stream import PickedStream
from capture_app.node.transfer.uploader import Uploader
from capture_app.node.wire.messages import JsonValue
from capture_app.sync.rig import events
from capture_app.sync.rig.client import Client

EVENTS_KEPT = 200


class PickedBursts:
    """Hands each burst over, with the record of its camera and what has happened since the last one."""

    def __init__(
        self, name: str, camera: CameraSupervisor, clock: NodeClock, uploader: Uploader, ring_bytes: int
    ) -> None:
        """`ring_bytes` bound what waits of a burst that is sent as it comes."""
        self._name = name
        self._camera, self._clock, self._uploader = camera, clock, uploader
        self._ring_bytes = ring_bytes
        self._events: deque[dict[str, JsonValue]] = deque(maxlen=EVENTS_KEPT)

    def note(self, line: dict[str, JsonValue]) -> None:
        """Keep what happened for the next burst's report."""
        self._events.append(line)

    def upload(
        self,
        picked: events.BurstPicked[CapturedFrame],
        engine: Client[CapturedFrame],
        tolerance_ns: int,
    ) -> None:
        """Begin the upload of a burst, or go on with it; the phase was to be held to `tolerance_ns`."""
        ready = with_device_clock(picked)
        if ready.further:
            missing = missing_images(self._name, ready.gaps)
            self._uploader.extend_burst(
                ready.leader, ready.burst, ready.picks, missing, over=ready.over, ended=ready.ended
            )
            return
        camera, corrections = self._camera, engine.aligner.corrections
        record = camera_record(
            self._name, camera.facts, ready, corrections, tolerance_ns, camera.device_clock
        )
        truth = true_clock(self._clock, camera.facts)
        report = camera_report(record, ready, camera.calibration, truth, tuple(self._events))
        self._events.clear()
        if ready.trigger is not None:
            stream = PickedStream(ready.trigger.video, self._ring_bytes)
            begun = replace(report, instants=(), missing=(), picking=True)
            upload = BurstUpload(begun, deque(), stream=stream)
            upload.extend(ready.picks, report.missing, over=ready.over, ended=ready.ended)
            self._uploader.add_burst(upload)
            return
        forget = functools.partial(engine.forget_burst, ready.leader, ready.burst)
        self._uploader.add_burst(BurstUpload(report, deque(ready.picks), on_settled=forget))
