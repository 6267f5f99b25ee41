"""Sound on the rig's time, by a line that is fitted to its own clock.

An imported recording has it beside its frames; images of a camera with a microphone carry it.
"""

import wave
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.common.grouping import grouped
from capture_app.common.plugins import load_plugins
from capture_app.session.alignment.clock_line import fit_clock_line
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.importing.video_tracks import read_track, video_times_ns

RATE_HZ = 48_000
BLOCK = 1024
"""Samples of one AAC frame."""
FRAME_SD_S, PART_SD_S = 1e-3, 1e-4
"""Standard deviation of a recording's frame times, and of a sound's times in images."""
SOUNDS = "simulshot.sounds"
"""Entry-point group of modules with `read_sounds(session, camera)`: parts of sound, each with its image."""
MAX_SOUND_S = 86_400.0
MAX_SLIP_S, MAX_RATE_PPM = 1.0, 20_000.0
"""How much farther apart than their times samples may be by their numbers, and a microphone's clock error."""
MAX_BEFORE_NS = 3_000_000_000
"""Maximum time from an image to the sound in it; a replayed image has the sound of another time."""
MAX_MISS_S = 5e-3
"""Distance of frames from the fitted clock above which the user is warned."""
TAPS, PHASES = 32, 512
_PLACES = np.arange(TAPS) - TAPS // 2 + 1
_DISTANCES = _PLACES - np.arange(PHASES + 1)[:, None] / PHASES
_SINC = np.sinc(_DISTANCES) * np.cos(np.pi * _DISTANCES / (TAPS + 2)) ** 2
KERNEL = (_SINC / _SINC.sum(1, keepdims=True)).astype(np.float32)
"""Windowed sinc (PHASES + 1, TAPS): linear interpolation would dull the treble."""

Samples = NDArray[np.int16]


def find_recording(folder: Path, camera: str) -> Path | None:
    """Return the file in `folder` that has a camera's name, whatever its suffix; None if there is none.

    Raises BadInputError if there are several.
    """
    if not folder.is_dir():
        raise BadInputError(f"{folder} is not a folder", hint="give the folder with the imported recordings")
    sounds = sorted(path for path in folder.iterdir() if path.stem == camera and path.is_file())
    if len(sounds) > 1:
        names = ", ".join(path.name for path in sounds)
        raise BadInputError(f"{folder} has several files for {camera}: {names}", hint="leave one there")
    return sounds[0] if sounds else None


def add_sound(burst: ExportedBurst, camera: str, recording: Path, video: Path) -> None:
    """Add a recording's sound to the camera's exported video, whose times count from `burst.origin_ns`.

    Raises BadInputError if the session was not imported from this recording, or the recording has no sound.
    """
    clock = fit_sound_clock(burst, camera, recording)
    try:
        samples, start_s = read_track(recording, RATE_HZ, "s16p", 2)
    except BadInputError as error:
        raise BadInputError(f"{recording} gives no sound: {error}", hint="export without --sound") from None
    firsts = range(0, round(_end_s(burst, camera) * RATE_HZ), BLOCK)
    _mux(video, _on_rig_time(samples, start_s, clock, firsts), len(samples))


def add_own_sound(burst: ExportedBurst, camera: str, video: Path, *, wav: bool) -> None:
    """Add the sound that a camera's images carry, if any, to its exported video; `wav`: also as a file."""
    streams = grouped(
        ((part.stream, part.rate_hz, part.channels), (image, part))
        for plugin in load_plugins(SOUNDS, "read_sounds").values()
        for image, part in plugin.read_sounds(burst.session, camera)
        if image.local_ns is not None and abs(part.local_ns - image.local_ns) <= MAX_BEFORE_NS
    )
    if not streams:
        return
    end_s = _end_s(burst, camera)
    if end_s > MAX_SOUND_S:
        burst.warn(f"{camera}: the video is longer than a day, so it has no sound")
        return
    firsts = range(0, round(end_s * RATE_HZ), BLOCK)
    sound = np.zeros((max(channels for _, _, channels in streams), len(firsts) * BLOCK), np.int16)
    for (_, rate_hz, channels), parts in streams.items():
        if not _add_stream(sound, burst.origin_ns, parts, rate_hz, channels):
            burst.warn(f"{camera}: sound whose sample numbers contradict its times is left out")
    _mux(video, (sound[:, first : first + BLOCK] for first in firsts), len(sound))
    if wav:
        with wave.open(str(video.with_suffix(".wav")), "wb") as file:
            file.setparams((len(sound), 2, RATE_HZ, 0, "NONE", ""))
            file.writeframes(sound[:, : round(end_s * RATE_HZ)].T.astype("<i2").tobytes())


def _end_s(burst: ExportedBurst, camera: str) -> float:
    """Return the end of a camera's video, s after the burst's origin."""
    return (burst.images_of(camera)[-1].leader_ns - burst.origin_ns + burst.period_ns) / 1e9


def _add_stream(
    sound: Samples, origin_ns: int, parts: list[tuple[ImageRecord, Any]], rate_hz: int, channels: int
) -> bool:
    """Add one run of a microphone to the burst's sound (channels, n), which begins at the burst's origin.

    Return False, and add nothing, if its sample numbers contradict the times at which they were heard.
    """
    begin = min(part.first for _, part in parts)
    length = max(part.first + part.samples for _, part in parts) - begin
    heard_ns = [part.local_ns for _, part in parts]
    # Before any memory is taken: sample numbers and times are whatever a camera's machine wrote.
    apart_s = (max(part.first for _, part in parts) - begin) / rate_hz
    longest_s = sound.shape[1] / RATE_HZ + 2 * MAX_BEFORE_NS / 1e9
    if apart_s > MAX_SLIP_S + min((max(heard_ns) - min(heard_ns)) / 1e9, longest_s):
        return False
    samples = np.zeros((channels, length), np.int16)
    for _, part in parts:
        at = part.first - begin
        samples[:, at : at + part.samples] = np.frombuffer(part.pcm, "<i2").reshape(-1, channels).T
    # The images' own times, by which the node's clock is converted to the leader's.
    pairs = sorted((image.local_ns or 0, image.leader_ns) for image, _ in parts)
    late_ns = [leader_ns - local_ns for local_ns, leader_ns in pairs]
    rig_ns = np.array(heard_ns) + np.interp(heard_ns, [local_ns for local_ns, _ in pairs], late_ns)
    own_s = np.array([part.first - begin for _, part in parts]) / rate_hz
    sd_s = np.full(len(parts), PART_SD_S)
    clock = fit_clock_line(own_s, (rig_ns - origin_ns) / 1e9, sd_s, "sound")
    if abs(clock.rate_ppm) > MAX_RATE_PPM:
        return False
    ends_s = (clock.leader_from_local(round(at_s * 1e9)) / 1e9 for at_s in (0, length / rate_hz))
    low, high = (min(max(0, int(end_s * RATE_HZ)), sound.shape[1]) // BLOCK for end_s in ends_s)
    firsts = range(low * BLOCK, min(high * BLOCK + BLOCK, sound.shape[1]), BLOCK)
    for first, block in zip(firsts, _on_rig_time(samples, 0.0, clock, firsts, rate_hz), strict=True):
        sound[:, first : first + BLOCK] += block
    return True


def fit_sound_clock(burst: ExportedBurst, camera: str, recording: Path) -> CameraTimes:
    """Return the line from a recording's own times, which its sound shares, to the burst's.

    Raises BadInputError if the camera's images are not frames of this recording.
    """
    times_ns, images = video_times_ns(recording), burst.images_of(camera)
    kind = burst.session.camera(camera).facts.kind
    numbers = [len(times_ns) if image.sequence is None else image.sequence for image in images]
    if kind != "imported" or max(numbers) >= len(times_ns):
        raise BadInputError(
            f"{camera} was not imported from {recording}, which has {len(times_ns)} frames",
            hint="--sound takes the recordings from which sessions import made the session",
        )
    own_s = np.array([times_ns[number] for number in numbers]) / 1e9
    rig_s = np.array([image.leader_ns - burst.origin_ns for image in images]) / 1e9
    clock = fit_clock_line(own_s, rig_s, np.full(len(own_s), FRAME_SD_S), "frames")
    fitted_s = np.array([clock.leader_from_local(times_ns[number]) for number in numbers]) / 1e9
    miss_s = float(np.percentile(np.abs(fitted_s - rig_s), 95))
    if miss_s > MAX_MISS_S:
        burst.warn(f"{camera}: frames are up to {1000 * miss_s:.0f} ms from the sound's clock")
    return clock


def _on_rig_time(
    samples: Samples, start_s: float, clock: CameraTimes, firsts: Sequence[int], rate_hz: int = RATE_HZ
) -> Iterator[Samples]:
    """Yield blocks (channels, BLOCK) of the burst's time that begin at the samples `firsts`.

    They are silent where there is no sound. `rate_hz` is the rate of `samples`.
    """
    ahead, behind = TAPS // 2, TAPS
    # The inverse of `leader_from_local`.
    zero_s, rate = clock.leader_from_local(0) / 1e9, clock.rate_ppm * 1e-6
    for first in firsts:
        rig_s = (first + np.arange(BLOCK)) / RATE_HZ
        at = ((rig_s - zero_s) / (1 + rate) - start_s) * rate_hz
        whole = np.floor(at).astype(np.int64)
        low, high = int(whole[0]) - ahead, int(whole[-1]) + behind
        there = samples[:, max(0, low) : max(0, high)]
        left = min(max(0, -low), high - low)
        near = np.zeros((len(samples), high - low), np.float32)
        near[:, left : left + there.shape[1]] = there
        taps = near[:, (whole - low)[:, None] + _PLACES]
        made = np.einsum("cnt,nt->cn", taps, KERNEL[np.rint((at - whole) * PHASES).astype(int)])
        yield np.clip(np.rint(made), -32768, 32767).astype(np.int16)


def _mux(video: Path, blocks: Iterator[Samples], channels: int) -> None:
    """Add the sound as AAC between the video's packets, which stay unchanged."""
    import av

    out = video.with_name(f"{video.stem}.sound.mp4")
    options = {"movie_timescale": "1000000"}
    with av.open(str(video)) as given, av.open(str(out), "w", format="mp4", options=options) as container:
        pictures = given.streams.video[0]
        stream = container.add_stream_from_template(pictures)
        stream.time_base = pictures.time_base
        layout = "mono" if channels == 1 else "stereo"
        track = container.add_stream("aac", rate=RATE_HZ, layout=layout)
        written = 0
        for packet in given.demux(pictures):
            if packet.dts is None:
                continue
            until = float(packet.dts * packet.time_base) * RATE_HZ
            while written <= until and (block := next(blocks, None)) is not None:
                container.mux(track.encode(_frame(block, layout, written)))
                written += BLOCK
            packet.stream = stream
            container.mux(packet)
        for block in blocks:
            container.mux(track.encode(_frame(block, layout, written)))
            written += BLOCK
        container.mux(track.encode(None))
    out.replace(video)


def _frame(block: Samples, layout: str, first: int) -> Any:
    import av

    frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(block), format="s16p", layout=layout)
    frame.sample_rate, frame.pts = RATE_HZ, first
    return frame
