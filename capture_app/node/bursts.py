"""A burst on the leader's side: reports and images come in, a session comes out, whatever is missing."""

import asyncio
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.errors import BadInputError, SimulshotError
from capture_app.node.messages import CameraReport, ImageUpload
from capture_app.node.status import BurstStatus
from capture_app.session.calibration import Calibration
from capture_app.session.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.store import SessionWriter
from capture_app.sync.messages import CameraDescription
from capture_app.sync.trigger import Burst

PATIENCE_NS = 10_000_000_000
"""A camera that has had no stream open for this long has left its images behind."""
STALL_NS = 180_000_000_000
"""A camera that has a stream open and sends nothing for this long has too."""
AFTER_LAST_INSTANT_NS = 2_000_000_000


@dataclass(slots=True)
class _Share:
    """What one camera owes to the burst; times in ns of the leader's clock."""

    camera: CameraRecord
    heard_ns: int
    streams: int = 0
    report: CameraReport | None = None
    instants: set[int] = field(default_factory=set)
    given_up: str = ""

    def is_complete(self) -> bool:
        return bool(self.given_up) or (self.report is not None and self.instants >= set(self.report.instants))


class BurstSession:
    """Collects one burst into a session; finished when every camera has delivered or is given up."""

    def __init__(self, burst: Burst, cameras: Mapping[str, CameraDescription], writer: SessionWriter) -> None:
        self.burst = burst
        self.finished = asyncio.Event()
        self.session: Path | None = None
        self.message = ""
        self._writer = writer
        # One write at a time: a node that sends again after a broken stream meets its own first try.
        self._writing = asyncio.Lock()
        self._simulated = False
        begin_ns = burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS
        self._shares = {name: _Share(record_of(name, cameras[name]), begin_ns) for name in burst.clients}

    @property
    def status(self) -> BurstStatus:
        """How far it is."""
        instants = len(self.burst.instants_ns)
        return BurstStatus(
            burst=self.burst.number,
            name=self._writer.name,
            cameras=len(self._shares),
            instants=instants,
            received=sum(len(share.instants) for share in self._shares.values()),
            expected=len(self._shares) * instants,
            done=self.finished.is_set(),
            session=None if self.session is None else str(self.session),
            message=self.message,
        )

    def stream_opened(self, camera: str) -> None:
        """That camera is connected: its images may take their time."""
        self._share(camera).streams += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        """That camera's stream broke off or was closed."""
        share = self._share(camera)
        share.streams -= 1
        share.heard_ns = max(share.heard_ns, now_ns)

    async def take_report(self, report: CameraReport, now_ns: int) -> None:
        """Note what a camera will send. Raises BadInputError for a report that is not of this burst."""
        share = self._share(report.camera.name)
        for instant in (*report.instants, *(missing.instant for missing in report.missing)):
            self._check_instant(instant)
        async with self._writing:
            self._must_be_open()
            if share.report is None:
                for event in report.events:
                    await asyncio.to_thread(self._writer.add_event, {"camera": report.camera.name, **event})
            share.report = report
            share.heard_ns = max(share.heard_ns, now_ns)
        await self._finish_if_complete()

    async def take_image(self, upload: ImageUpload, payload: bytes, now_ns: int) -> str:
        """Save an image and return its checksum once it is on disk. Raises BadInputError."""
        record = upload.record
        share = self._share(record.camera)
        self._check_instant(record.instant)
        image = payload[: len(payload) - upload.truth_bytes]
        truth = payload[len(image) :]
        sha256 = hashlib.sha256(image).hexdigest()
        if len(image) != record.bytes or sha256 != record.sha256:
            raise BadInputError(f"the image of {record.camera} at instant {record.instant} came damaged")
        async with self._writing:
            self._must_be_open()
            if record.instant not in share.instants:
                await asyncio.to_thread(self._save, upload, image, truth)
            share.instants.add(record.instant)
            share.heard_ns = max(share.heard_ns, now_ns)
        await self._finish_if_complete()
        return sha256

    async def give_up(self, camera: str, reason: str) -> None:
        """Wait no longer for a camera."""
        share = self._shares.get(camera)
        if share is not None and not share.is_complete():
            share.given_up = reason
            await self._finish_if_complete()

    async def give_up_silent(self, lost: Mapping[str, str], now_ns: int) -> None:
        """Wait no longer for cameras without a stream, or lost (name to reason), or stalled."""
        for name, share in self._shares.items():
            silent_ns = now_ns - share.heard_ns
            if silent_ns >= PATIENCE_NS and (not share.streams or name in lost):
                await self.give_up(name, lost.get(name, "it sent nothing"))
            elif silent_ns >= STALL_NS:
                await self.give_up(name, f"it sent nothing for {STALL_NS // 10**9} s")

    async def stop(self, reason: str) -> None:
        """Finish with what is there."""
        for name in self._shares:
            await self.give_up(name, reason)

    def _share(self, camera: str) -> _Share:
        try:
            return self._shares[camera]
        except KeyError:
            raise BadInputError(f"camera {camera!r} is not in burst {self.burst.number}") from None

    def _check_instant(self, instant: int) -> None:
        if not 0 <= instant < len(self.burst.instants_ns):
            raise BadInputError(f"burst {self.burst.number} has no instant {instant}")

    def _must_be_open(self) -> None:
        if self.finished.is_set():
            raise BadInputError(f"burst {self.burst.number} is over")

    def _save(self, upload: ImageUpload, image: bytes, truth: bytes) -> None:
        record = upload.record
        # The truth first: an image that is on disk is one that needs nothing more.
        if truth and upload.true_ns is not None:
            self._simulated = True
            self._writer.add_ground_truth(record.camera, record.instant, truth, upload.true_ns)
        self._writer.add_image(
            image,
            camera=record.camera,
            instant=record.instant,
            leader_ns=record.leader_ns,
            suffix=Path(record.path).suffix,
            local_ns=record.local_ns,
            residual_ns=record.residual_ns,
            uncertainty_ns=record.uncertainty_ns,
            hard_bound_ns=record.hard_bound_ns,
            exposure_start_ns=record.exposure_start_ns,
            exposure_ns=record.exposure_ns,
            gain=record.gain,
            white_balance=record.white_balance,
            sequence=record.sequence,
            dropped=record.dropped,
            late=record.late,
        )

    async def _finish_if_complete(self) -> None:
        async with self._writing:
            if self.finished.is_set() or not all(share.is_complete() for share in self._shares.values()):
                return
            try:
                self.session = await asyncio.to_thread(self._finish)
            except SimulshotError as error:
                self.message = str(error)
            self.finished.set()

    def _finish(self) -> Path | None:
        missing = [gap for share in self._shares.values() for gap in self._missing_of(share)]
        received = sum(len(share.instants) for share in self._shares.values())
        if missing:
            reasons = sorted({f"{gap.camera}: {gap.reason}" for gap in missing})
            self.message = f"{len(missing)} images are missing ({'; '.join(reasons)})"
        if not received:
            self._writer.discard()
            self.message = f"no image came, so no session was made; {self.message}"
            return None
        reports = {name: share.report for name, share in self._shares.items() if share.report is not None}
        calibrated = {n: r.calibration for n, r in reports.items() if r.calibration is not None}
        if calibrated:
            self._writer.set_calibration(Calibration(cameras=calibrated, source="the simulated scene"))
        self._writer.set_ground_truth_clocks(
            {
                name: {
                    "offset_ns": report.true_clock.offset_ns,
                    "skew_ppm": report.true_clock.skew_ppm,
                    "epoch_true_ns": report.true_clock.epoch_true_ns,
                }
                for name, report in reports.items()
                if report.true_clock is not None
            }
        )
        cameras = [share.report.camera if share.report else share.camera for share in self._shares.values()]
        record = BurstRecord(
            instants_ns=self.burst.instants_ns,
            period_ns=self.burst.period_ns,
            requested_ns=self.burst.requested_ns,
        )
        origin = "simulated" if self._simulated else "captured"
        return self._writer.finish(cameras, record, missing, origin).folder

    def _missing_of(self, share: _Share) -> list[MissingImage]:
        told = {gap.instant: gap for gap in share.report.missing} if share.report else {}
        return [
            MissingImage(
                camera=share.camera.name,
                instant=instant,
                reason=told[instant].reason if instant in told else share.given_up or "it never came",
                dropped=instant in told and told[instant].dropped,
            )
            for instant in range(len(self.burst.instants_ns))
            if instant not in share.instants
        ]


def record_of(name: str, camera: CameraDescription) -> CameraRecord:
    """The record of a camera that has not reported."""
    return CameraRecord(
        name=name,
        kind=camera.kind,
        model=camera.model,
        width=camera.width,
        height=camera.height,
        period_ns=camera.period_ns,
        timestamp_source=camera.timestamp_source,
        row_time_ns=camera.row_time_ns,
    )


def create_numbered(root: Path) -> SessionWriter:
    """Begin the session `burst-NNN` of the next free number. Raises BadInputError."""
    number = 1 + max((_number(path) for path in root.glob("burst-*")), default=0)
    while True:
        name = f"burst-{number:03d}"
        try:
            return SessionWriter.create(root, name)
        except BadInputError:
            if not (root / name).exists():
                raise
        number += 1


def _number(path: Path) -> int:
    digits = path.name.removeprefix("burst-")
    return int(digits) if digits.isdecimal() else 0
