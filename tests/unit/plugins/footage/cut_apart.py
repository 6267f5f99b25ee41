"""One scene, recorded by cameras that know nothing of each other: own start, own rate, sound, flashes.

Rows are exposed one after the other; a frame's time is the middle of its middle row's exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SOUND_HZ = 48_000
US = 1_000_000


@dataclass(frozen=True)
class Take:
    """What happens, in true time (s): claps, flashes that last `flash_s`, a lamp that goes on, off, on..."""

    claps_s: Sequence[float] = ()
    flashes_s: Sequence[float] = ()
    flash_s: float = 0.0005
    lamp_s: Sequence[float] = ()
    seed: int = 0

    def sound(self, at_s: np.ndarray) -> np.ndarray:
        """The sound at true times (n,): claps, each of its own tones."""
        heard = np.zeros(len(at_s))
        for number, clap_s in enumerate(self.claps_s):
            rng = np.random.default_rng([self.seed, number])
            tones = rng.uniform(400, 5000, 24), rng.uniform(0, 2 * np.pi, 24)
            since = at_s - clap_s
            near = (since > 0) & (since < 0.25)
            rings = sum(np.sin(2 * np.pi * hz * since[near] + at) for hz, at in zip(*tones, strict=True))
            heard[near] += rings * np.exp(-since[near] / 0.02) / 12
        return heard


@dataclass(frozen=True)
class Phone:
    """A camera: it starts at a true time, and its clock runs `ppm` too fast."""

    name: str
    start_s: float = 0.0
    fps: float = 30.0
    ppm: float = 0.0
    jitter_s: float = 0.0
    """Of its frames' times, which it tells."""
    readout_s: float = 0.016
    exposure_s: float = 0.008
    timecode: str = ""
    created: str = ""
    """When it began, as it writes it into its video (RFC 3339)."""
    noise: float = 0.01
    """Of its microphone, against a clap of about 1."""
    seed: int = 1
    size: tuple[int, int] = field(default=(64, 96))
    """Width and height, px."""

    def own_s(self, true_s: np.ndarray | float) -> np.ndarray | float:
        """Its own time of a true one."""
        return (np.asarray(true_s) - self.start_s) * (1 + self.ppm * 1e-6)

    def true_s(self, own_s: np.ndarray | float) -> np.ndarray | float:
        """The true time of one of its own."""
        return self.start_s + np.asarray(own_s) / (1 + self.ppm * 1e-6)

    def record(
        self, take: Take, path: Path, seconds: float, *, sound: bool = True, metadata: Sequence[bytes] = ()
    ) -> Path:
        """Write its video of so many seconds (of its own), with sound; `metadata`: payloads, one a second."""
        rng = np.random.default_rng(self.seed)
        count = int(seconds * self.fps)
        at_s = np.arange(count) / self.fps + rng.uniform(0, self.jitter_s, count) if self.jitter_s else (
            np.arange(count) / self.fps
        )  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(path), "w", options={"movie_timescale": str(US)}) as container:
            if self.created:
                container.metadata["creation_time"] = self.created
            rate = Fraction(self.fps).limit_denominator(1001)
            video = container.add_stream("libx264", rate=rate)
            video.width, video.height, video.pix_fmt = *self.size, "yuv420p"
            video.options = {"crf": "12", "preset": "ultrafast", "bf": "0"}
            video.time_base = video.codec_context.time_base = Fraction(1, US)
            if self.timecode:
                video.metadata["timecode"] = self.timecode
            track = container.add_stream("aac", rate=SOUND_HZ, layout="mono") if sound else None
            # What ffmpeg calls binary data is a track of type gpmd in an MP4. A GoPro has others before it.
            other = container.add_data_stream("bin_data") if metadata else None
            data = container.add_data_stream("bin_data") if metadata else None
            for own_s in at_s:
                frame = av.VideoFrame.from_ndarray(self._picture(take, own_s, rng), format="gray")
                frame.pts, frame.time_base = round(own_s * US), video.time_base
                container.mux(video.encode(frame.reformat(format="yuv420p")))
            container.mux(video.encode(None))
            for stream, payloads in ((other, [b"\0\0\0\1"]), (data, metadata)):
                for number, payload in enumerate(payloads if stream is not None else ()):
                    packet = av.Packet(payload)
                    packet.stream, packet.time_base = stream, Fraction(1, 1000)
                    packet.pts = packet.dts = number * 1000
                    packet.duration = 1000
                    container.mux(packet)
            if track is not None:
                # Its microphone samples by its own clock.
                own = np.arange(int(seconds * SOUND_HZ)) / SOUND_HZ
                heard = take.sound(np.asarray(self.true_s(own))) + self.noise * rng.standard_normal(len(own))
                for begin in range(0, len(own), 1024):
                    part = heard[begin : begin + 1024].astype(np.float32)[None]
                    spoken = av.AudioFrame.from_ndarray(part, format="fltp", layout="mono")
                    spoken.sample_rate, spoken.pts, spoken.time_base = SOUND_HZ, begin, Fraction(1, SOUND_HZ)
                    container.mux(track.encode(spoken))
                container.mux(track.encode(None))
        return path

    def _picture(self, take: Take, own_s: float, rng: np.random.Generator) -> np.ndarray:
        """A grey frame whose middle row's exposure has its middle at `own_s`."""
        width, height = self.size
        rows_s = own_s + self.readout_s * ((np.arange(height) + 0.5) / height - 0.5)
        middle = self.true_s(rows_s)
        light = np.zeros(height)
        for flash_s in take.flashes_s:
            first = np.maximum(middle - self.exposure_s / 2, flash_s)
            last = np.minimum(middle + self.exposure_s / 2, flash_s + take.flash_s)
            light += np.clip(last - first, 0, None) / take.flash_s
        lit = np.zeros(height)
        for number, change_s in enumerate(take.lamp_s):
            since = np.clip((middle - change_s) / self.exposure_s + 0.5, 0, 1)
            lit += since if number % 2 == 0 else -since
        light += lit * 0.8
        ground = 60 + 30 * np.sin(np.arange(width) / 5)[None] + 20 * np.cos(np.arange(height) / 9)[:, None]
        grey = ground * (1 + 1.2 * light[:, None]) + rng.normal(0, 2, (height, width))
        return np.clip(grey, 0, 255).astype(np.uint8)
