"""A stand-in for `rpicam-vid --sync client` on a Pi, from what its algorithm does with a packet."""

import random
import struct
from dataclasses import replace

from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.plugins.cameras.sim.sensor import Sensor, SensorFrame

DEAD_BAND_US = 50


class RpicamClient:
    """A camera with whole rows; its wall clock is true, its stamp the end of the first row's exposure."""

    def __init__(self, seed: int, *, ppm: float, start_true_ns: int) -> None:
        profile = replace(PROFILES["pi"], drop_fraction=0.0, outlier_fraction=0.0)
        self.sensor = Sensor(profile, random.Random(seed), period_error_ppm=ppm)
        self.sensor.start(start_true_ns)
        self.frames: list[SensorFrame] = []
        self.ready_us: int | None = None
        self._typical_ns = profile.period_ns
        self._packet = b""

    def receive(self, packet: bytes) -> None:
        """Take in a packet; the last one before a frame counts."""
        self._packet = packet

    def run_until(self, true_ns: int) -> None:
        """Take the frames until then, and obey the packet at the first of them."""
        while not self.frames or self.frames[-1].readout_end_true_ns < true_ns:
            frame = self.sensor.next_frame()
            self.frames.append(frame)
            if self._packet:
                self._obey(frame, *struct.unpack("<I4xQQQQ", self._packet))
                self._packet = b""

    def _obey(self, frame: SensorFrame, duration: int, _: int, server: int, __: int, ready: int) -> None:
        own = (frame.timestamp_true_ns + frame.exposure_ns) // 1000
        periods = round((own - server) / duration)
        early = own - periods * duration - server
        self.ready_us = ready
        if abs(early) >= DEAD_BAND_US:
            self.sensor.set_frame_duration(self._typical_ns - early * 1000, frame.readout_end_true_ns)
