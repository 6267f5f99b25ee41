"""Viewfinder of a node's camera for operators: previews, frame rate, exposure, and details.

It yields to the clock and to bursts. Previews are made in a low-priority thread, one at a time, and rarely
while images are taken or sent, as a recording is for hours. All cameras of a rig show the same instants.
"""

import asyncio
from collections import deque
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.tasks import first_of, has_come
from capture_app.net.channel import Channel, connect
from capture_app.node.camera.device_profiles import camera_key, link_key
from capture_app.node.camera.supervisor import CameraSupervisor, NodeOptions
from capture_app.node.camera.uploader import Uploader
from capture_app.protocol.messages import FromLeader, NodeStream, Refusal
from capture_app.protocol.orders import (
    NO_PREVIEWS,
    CameraHealth,
    ControlsAnswer,
    ControlsRequest,
    DetailRequest,
    PreviewRequest,
    PreviewSeen,
    RemoveCamera,
    SaveStamp,
    StampSaved,
)
from capture_app.protocol.status import NodeDetail, Preview
from capture_app.session.files.disk import free_bytes
from capture_app.session.reading.decoding import encode_image
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig.client import Client

RETRY_S = 2.0
HEALTH_INTERVAL_S = 1.0
MAX_FRAMES, MAX_LINES = 300, 100
RATE_WINDOW_NS = 2_000_000_000
JPEG_QUALITY = 75
BUSY_FPS = 1.25
"""Maximum rate of previews while frames are selected or sent; one of 1080p takes some 10 ms of a core."""
RATE_TOLERANCE = 1.05
"""Maximum rate of previews over the requested one: a frame period is not exactly 1/30 s."""
MAX_PERIODS = 3 << 12
MAX_INTERVALS = 3
"""Requested intervals after which any frame is shown of a camera that has none of the rig's instants."""


def offsets_of(samples: Collection[ClockSample], skew_ppm: float | None) -> tuple[tuple[int, int], ...]:
    """Return offset and round trip of exchanges with the leader, in ns.

    The leader's clock gains `skew_ppm` on this one. The drift since each exchange is added to its offset, so
    that the scatter of the offsets shows the exchanges' errors.
    """
    rate = (skew_ppm or 0.0) * 1e-6
    last_ns = max((sample.t3_ns for sample in samples), default=0)
    return tuple(
        (
            (sample.lower_ns + sample.upper_ns) // 2 + round(rate * (last_ns - sample.t3_ns)),
            sample.round_trip_ns,
        )
        for sample in samples
    )


class Viewfinder:
    """Viewfinder of one camera; keeps a stream open, over which the leader requests previews."""

    def __init__(
        self,
        options: NodeOptions,
        instance: int,
        camera: CameraSupervisor,
        engine: Client[CapturedFrame],
        uploader: Uploader,
        samples: Collection[ClockSample],
    ) -> None:
        """Create a viewfinder of a node, from its parts and its latest exchanges with the leader.

        `instance` is the number of the node's run.
        """
        self.stamps_ns: deque[int] = deque(maxlen=MAX_FRAMES)
        """Timestamps of the latest frames, by the node's clock."""
        self.newest: CapturedFrame | None = None
        self._options, self._instance, self._name = options, instance, options.name
        self._camera, self._engine, self._uploader, self._samples = camera, engine, uploader, samples
        self._leader: Address
        self._leader_changed = asyncio.Event()
        self._channel: Channel[Any] | None = None
        self.request = NO_PREVIEWS
        """Previews requested now."""
        self._next: tuple[CapturedFrame, int | None] | None = None
        """Frame of the next preview, with the leader time of the instant that it shows."""
        self._chosen_ns: int | None = None
        """Timestamp of the frame chosen last, or of the first one that could be."""
        self._frame_chosen = asyncio.Event()
        self._may_send = asyncio.Event()
        self._thread = ThreadPoolExecutor(1, "preview")

    @property
    def health(self) -> CameraHealth:
        """Current frame rate, exposure and gain."""
        newest, since_ns = self.newest, self._options.clock.now_ns() - RATE_WINDOW_NS
        recent = [stamp for stamp in self.stamps_ns if stamp >= since_ns]
        fps = 0.0 if self.stamps_ns else None
        if len(recent) > 1:
            span_ns = max(recent) - min(recent)
            fps = round((len(recent) - 1) * 1e9 / span_ns, 1) if span_ns else None
        return CameraHealth(
            fps=fps,
            exposure_ns=None if newest is None else newest.exposure_ns,
            gain=None if newest is None else newest.gain,
        )

    def add_frame(self, frame: CapturedFrame) -> None:
        """Note the next frame of the stream, and choose it for a preview if one is due."""
        self.newest = frame
        self.stamps_ns.append(frame.timestamp_ns)
        if not self.request.fps:
            return
        fps = min(self.request.fps, BUSY_FPS) if self.is_busy else self.request.fps
        place = self._engine.instant_of(frame.timestamp_ns)
        if self._chosen_ns is None:
            self._chosen_ns = frame.timestamp_ns
        since_ns, shown_ns = abs(frame.timestamp_ns - self._chosen_ns), None
        if place is not None and place[0] % periods_between(place[1].period_ns, fps) == 0:
            shown_ns = place[1].instant(place[0])
        elif since_ns * fps < (1e9 if place is None else MAX_INTERVALS * 1e9):
            return
        self._chosen_ns, self._next = frame.timestamp_ns, (frame, shown_ns)
        self._frame_chosen.set()

    def set_leader(self, leader: Address) -> None:
        """Open the stream to that leader, and reopen it if the leader was restarted."""
        self._leader = leader
        self._leader_changed.set()
        if self._channel is not None:
            self._channel.abort()

    async def run(self) -> None:
        """Keep the stream open, and send what is requested, until cancelled."""
        try:
            await self._leader_changed.wait()
            while True:
                self._leader_changed.clear()
                with suppress(NetworkError):
                    async with await connect(self._leader, FromLeader, trust=self._options.trust) as channel:
                        if not self._leader_changed.is_set():
                            await self._serve(channel)
                # A leader that returns after a loss is a new run, announced by `set_leader`.
                await has_come(self._leader_changed, RETRY_S)
        finally:
            self._thread.shutdown(wait=False, cancel_futures=True)

    async def _serve(self, channel: Channel[Any]) -> None:
        self._channel, self.request, self._chosen_ns = channel, NO_PREVIEWS, None
        self._frame_chosen.clear()
        self._may_send.set()
        await channel.send(NodeStream(camera=self._name, instance=self._instance, shows=True))
        try:
            await first_of(self._listen(channel), self._send_health(channel), self._show(channel))
        finally:
            self._channel = None

    async def _listen(self, channel: Channel[Any]) -> None:
        controls = self._camera.controls
        while (message := await channel.receive_header()) is not None:
            match message:
                case PreviewRequest():
                    self.request = message
                case PreviewSeen():
                    self._may_send.set()
                case DetailRequest():
                    await channel.send(self.detail())
                case ControlsRequest(values=values):
                    state = await (controls.apply(values) if values else controls.read())
                    await channel.send(ControlsAnswer(camera=self._name, state=state))
                case SaveStamp() if message.camera == self._name:
                    await channel.send(self.save_stamp(message))
                case RemoveCamera() if message.name == self._name:
                    self._options.put_off()
                case Refusal():
                    raise NetworkError(message.what, hint=message.hint)
        raise NetworkError(
            "the leader closed the stream",
            hint=f"check that it runs: capture-app status --leader {channel.peer}",
        )

    async def _send_health(self, channel: Channel[Any]) -> None:
        sent = None
        while True:
            if (health := self.health) != sent:
                sent = health
                await channel.send(health)
            await asyncio.sleep(HEALTH_INTERVAL_S)

    async def _show(self, channel: Channel[Any]) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await self._may_send.wait()
            await self._frame_chosen.wait()
            self._frame_chosen.clear()
            if self._next is None:
                continue
            frame, shown_ns = self._next
            made = await loop.run_in_executor(self._thread, small_jpeg, frame, self.request.width)
            if made is None:
                continue
            jpeg, width, height = made
            self._may_send.clear()
            time_map = self._engine.time_map
            preview = Preview(
                camera=self._name,
                leader_ns=None if time_map is None else time_map.leader_from_local(frame.timestamp_ns),
                instant_ns=shown_ns,
                width=width,
                height=height,
            )
            await channel.send(preview, jpeg)

    @property
    def is_busy(self) -> bool:
        """Whether previews are rare, because frames of a burst are being selected or sent."""
        return self._engine.has_burst_pending or self._uploader.is_busy

    def save_stamp(self, measured: SaveStamp) -> StampSaved:
        """Apply a measurement from now on; return whether it is saved for later runs, too."""
        profiles, is_stored, uncertainty_ns = self._options.profiles, True, None
        if measured.stamp is not None:
            facts = self._camera.facts
            self._camera.measured_stamp = measured.stamp
            self._camera.note_exposure()
            is_stored = profiles.save(camera_key(self._name, facts), stamp=measured.stamp)
        if measured.asymmetry is not None:
            asymmetry = self._engine.add_path_asymmetry(measured.asymmetry)
            uncertainty_ns = asymmetry.uncertainty_ns
            is_stored = profiles.save(link_key(self._name, self._leader.host), asymmetry=asymmetry)
        return StampSaved(camera=self._name, is_stored=is_stored, asymmetry_uncertainty_ns=uncertainty_ns)

    def detail(self) -> NodeDetail:
        """Return what is too large for a status: clock samples, phase errors, log lines, controls."""
        places, health = map(self._engine.instant_of, self.stamps_ns), self.health
        skew_ppm = self._engine.report(self._options.clock.now_ns()).skew_ppm
        spool = self._uploader.spool
        return NodeDetail(
            camera=self._name,
            samples=offsets_of(self._samples, skew_ppm),
            phase_errors_ns=tuple(place[2] for place in places if place is not None),
            log=self._options.log.after(0)[-MAX_LINES:],
            fps=health.fps,
            exposure_ns=health.exposure_ns,
            gain=health.gain,
            white_balance=None if self.newest is None else self.newest.white_balance,
            controls=self._camera.controls.latest,
            spool="" if spool is None else str(spool.folder),
            disk_free_bytes=None if spool is None else free_bytes(spool.folder),
        )


def periods_between(period_ns: int, fps: float) -> int:
    """Return the frame periods from one preview to the next, at up to `fps`: 1, or 3 times a power of 2.

    Previews are of the rig's instants whose number is a multiple of it. The instants of slow previews are
    thus among those of faster ones: all cameras show the same instants, at whatever rate each is requested.
    """
    periods = 1
    while periods * period_ns * fps * RATE_TOLERANCE < 1e9 and periods < MAX_PERIODS:
        periods = 2 * periods if periods > 1 else 3
    return periods


def small_jpeg(frame: CapturedFrame, width: int) -> tuple[bytes, int, int] | None:
    """Return a JPEG of a frame at most `width` pixels wide, its width and height; None if that fails."""
    import cv2

    try:
        picture = frame.picture.reduced(width)
        if picture.shape[1] > width:
            height = max(1, round(picture.shape[0] * width / picture.shape[1]))
            picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        data = encode_image(picture, quality=JPEG_QUALITY)
    except Exception:  # noqa: BLE001 - drivers and decoders raise what they like; the next frame may do
        return None
    return data, picture.shape[1], picture.shape[0]
