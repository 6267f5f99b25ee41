"""Replay of a recording as a live camera, at its recorded times and in a loop."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import read_number
from capture_app.common import system
from capture_app.common.camera_facts import CameraListing, PhaseControl
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.manifest import MANIFEST
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream

if TYPE_CHECKING:
    from capture_app.plugins.cameras.replay.recordings import Recording

SPEC = "replay:PATH[,camera=NAME][,key=value…]"
HELP = "A session, a video or a folder of images, played in a loop at its recorded rate."
NEEDS = ""
OPTIONS = {
    "camera": "which of several cameras of the recording; default: the one named like the node",
    "fps": "rate of a video or of images, instead of their own times",
    "phase": "how its phase is moved: reset, frame-duration, or none to keep the recording's own",
}
PHASES = (PhaseControl.RESET, PhaseControl.FRAME_DURATION, PhaseControl.NONE)
DELIVERY_NS = 3_000_000
"""Delay from the end of a frame's readout to its callback, as drivers have."""
STALL_NS = 500_000_000
"""A driver has few buffers: frames that are not fetched within this time are dropped."""


def list_cameras() -> list[CameraListing]:
    """Return none: recordings are named by their paths."""
    return []


def open_camera(path: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a session, a video or a folder of images as a camera; see OPTIONS.

    Raises BadInputError for a path without a recording, a camera it does not have, or an unreadable option,
    IncompleteError for a session that is not complete.
    """
    fps, phase = read_number(options, "fps", "a replay", low=0.1, high=10_000), options.get("phase")
    if phase is not None and phase not in PHASES:
        raise BadInputError(f"phase={phase} of a replay", hint=f"one of {', '.join(PHASES)}")

    recording = _open(Path(path).expanduser(), options.get("camera"), fps, name)
    if phase is not None:
        recording.facts = replace(recording.facts, phase_control=PhaseControl(phase))
    return ReplayCamera(recording).in_clock(clock)


def _open(path: Path, camera: str | None, fps: float | None, node: str) -> "Recording":
    # Imported here because they are heavy and listing cameras does not need them.
    from capture_app.plugins.cameras.replay.recordings import SessionRecording, SourceRecording
    from capture_app.session.importing.importer import open_sources
    from capture_app.session.reading.reader import Session

    if (path / MANIFEST).exists():
        if fps is not None:
            raise BadInputError(f"{path} is a session and has times of its own", hint="leave fps= out")
        session = Session.open(path)
        names = [record.name for record in session.stored_manifest.cameras]
        return SessionRecording(session, session.camera(_choice(path, names, camera, node)))
    sources = {source.name: source for source in open_sources([str(path)])}
    return SourceRecording(sources[_choice(path, list(sources), camera, node)], fps)


def _choice(path: Path, names: list[str], camera: str | None, node: str) -> str:
    """Return the requested camera, or the one named like the node, or the only one."""
    if camera is None and node not in names and len(names) > 1:
        raise BadInputError(
            f"{path} has several cameras", hint=f"choose one: camera={names[0]}; it has {', '.join(names)}"
        )
    chosen = camera or (node if node in names else names[0])
    if chosen not in names:
        raise BadInputError(f"{path} has no camera {chosen}", hint=f"it has {', '.join(names)}")
    return chosen


class ReplayCamera(Camera):
    """Plays a recording in the host's monotonic clock; a task waits for each frame's time."""

    def __init__(self, recording: "Recording") -> None:
        from capture_app.plugins.cameras.replay.recordings import Playback  # heavy, as above

        self._recording, self._facts = recording, recording.facts
        self._playback = Playback(
            recording.timing, restarts=recording.facts.phase_control is PhaseControl.RESET
        )
        self._playing: asyncio.Task[None] | None = None

    @property
    def calibration(self) -> CameraCalibration | None:
        """Calibration stored in the recording."""
        return self._recording.calibration

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start playing. Raises CameraError if it is already playing."""
        if self._playing is not None:
            raise CameraError(f"the replay of {self.facts.model} was started already")
        self.listen(on_frame, on_failure)
        self._play_from(system.monotonic_ns())

    async def apply(self, command: CameraCommand) -> None:
        """Change the duration of the next frame, or begin a new stream; its delay counts from this call.

        Raises CameraError if it is not playing, and for commands that a recording cannot follow.
        """
        asked_ns = system.monotonic_ns()
        if self._playing is None:
            raise CameraError(f"the replay of {self.facts.model} does not run")
        if self.facts.phase_control is PhaseControl.NONE or isinstance(command, InjectFrame):
            raise CameraError(f"the replay of {self.facts.model} cannot do that")
        if isinstance(command, RestartStream):
            await self.stop()
            self._play_from(asked_ns + command.delay_ns)
            await asyncio.sleep(command.delay_ns / 1e9)
        else:
            self._playback.lengthen_frame(command.duration_ns)

    async def stop(self) -> None:
        """Stop playing. Calling it twice is harmless."""
        playing, self._playing = self._playing, None
        if playing is not None:
            playing.cancel()
            await asyncio.wait((playing,))

    def _play_from(self, start_ns: int) -> None:
        self._playback.start(start_ns)
        self._playing = asyncio.create_task(self._play())

    async def _play(self) -> None:
        loop, recording = asyncio.get_running_loop(), self._recording
        readout_ns = (self.facts.row_time_ns or 0) * (self.facts.height - 1)
        while True:
            index, sequence, stream, start_ns = self._playback.next_frame()
            record = recording.record(index)
            exposure_ns = None if record is None else record.exposure_ns
            due_ns = start_ns + (exposure_ns or 0) + readout_ns + DELIVERY_NS
            if system.monotonic_ns() - due_ns > STALL_NS:
                await asyncio.sleep(0)
                continue
            try:
                picture = await loop.run_in_executor(None, recording.picture, index)
            except Exception as error:  # noqa: BLE001 - decoders raise any, and the stream would just end
                self._on_failure(
                    CameraError(
                        f"the replay of {self.facts.model} cannot go on: {error}",
                        hint="check that the recording is still there and readable",
                    )
                )
                return
            await asyncio.sleep(max(0, due_ns - system.monotonic_ns()) / 1e9)
            if picture is None:
                continue  # its number is missing from the stream, as with any dropped frame
            self._on_frame(
                CapturedFrame(
                    sequence=sequence,
                    stream=stream,
                    timestamp_ns=start_ns + (0 if record is None else record.outlier_ns),
                    picture=picture,
                    exposure_ns=exposure_ns,
                    gain=None if record is None else record.gain,
                    white_balance=None if record is None else record.white_balance,
                )
            )
