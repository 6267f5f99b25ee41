"""Microphones: of ALSA, through `arecord`, and a simulated one."""

import os
import select
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Protocol

import numpy as np

from capture_app.cameras.specs import CameraSpec
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError, NotAvailableError
from capture_app.plugins.cameras.sound.sound_ring import RATE_HZ

SIMULATED, OVERRUN, OWN = "sim", "sim:overrun", "own"
SIMULATED_PPM = 100.0
PERIOD_US = 20_000
SILENT_S = 5.0
"""Time without samples after which a microphone counts as lost."""
CLICK_SAMPLES, CLICK = 20, 20_000
DELAY_NS = 2_000_000
STALL_EVERY_NS, STALL_NS = 3_000_000_000, 150_000_000
LOST_FROM, LOST_TO = 3 * RATE_HZ, 3 * RATE_HZ + RATE_HZ // 4
OnSound = Callable[[bytes, int], None]
"""Takes samples, mono of 16 bits, and their arrival in ns of the node's clock."""


class Microphone(Protocol):
    """A source of sound at RATE_HZ."""

    def listen(self, on_sound: OnSound, closing: threading.Event) -> None:
        """Block and pass samples on until `closing` is set. Raises CameraError if the microphone is lost."""


class AlsaMicrophone:
    """A microphone of ALSA by its device, such as `hw:1`."""

    def __init__(self, device: str, clock: NodeClock) -> None:
        """Raises NotAvailableError without arecord."""
        # The plug layer converts rate and channels where the hardware has others.
        self._device = f"plug{device}" if device.startswith("hw:") else device
        self._clock, program = clock, shutil.which("arecord")
        if program is None:
            raise NotAvailableError(
                "a microphone needs arecord, which is not installed",
                hint="on Debian and Raspberry Pi OS: sudo apt install alsa-utils",
            )
        raw = ("-q", "-t", "raw", "-f", "S16_LE", "-c", "1", "-r", str(RATE_HZ))
        self._command = (program, "-D", self._device, *raw, f"--period-time={PERIOD_US}")

    def listen(self, on_sound: OnSound, closing: threading.Event) -> None:
        """Record until `closing` is set; see `Microphone.listen`."""
        # An unread pipe would fill with its words about overruns.
        with tempfile.TemporaryFile() as words:
            child = subprocess.Popen(  # noqa: S603 - the device is one argument, and no shell reads it
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=words,
                # Ctrl-C is for the node, which then ends the recording.
                start_new_session=True,
            )
            with child:
                assert child.stdout is not None
                try:
                    self._read(child.stdout.fileno(), on_sound, closing)
                finally:
                    child.kill()
            if not closing.is_set():
                words.seek(0)
                lines = words.read().decode(errors="replace").split("\n")
                said = next((line for line in reversed(lines) if line.strip()), "arecord has ended")
                raise CameraError(
                    f"the microphone {self._device} ended: {said.strip()}",
                    hint="arecord -l lists the microphones; use hw:CARD",
                )

    def _read(self, pipe: int, on_sound: OnSound, closing: threading.Event) -> None:
        """Pass samples on until `closing` is set or the pipe ends."""
        odd, last_ns = b"", self._clock.now_ns()
        while not closing.is_set():
            there, _, _ = select.select([pipe], [], [], 0.2)
            data = os.read(pipe, 1 << 16) if there else None
            now_ns = self._clock.now_ns()
            if data == b"":
                return
            if data:
                data, last_ns = odd + data, now_ns
                whole = len(data) // 2 * 2
                odd = data[whole:]
                on_sound(data[:whole], now_ns)
            elif now_ns - last_ns > SILENT_S * 1e9:
                raise CameraError(
                    f"the microphone {self._device} delivers nothing", hint="unplug it and plug it in again"
                )


class SimulatedSound:
    """Samples that click at whole seconds of the host's clock, by a sample clock that is `ppm` fast."""

    def __init__(self, begin_true_ns: int, ppm: float = SIMULATED_PPM) -> None:
        """Sample 0 is taken at `begin_true_ns` of the host's clock."""
        self._begin_true_ns = begin_true_ns
        self._step_ns = 1e9 / (RATE_HZ * (1 + ppm * 1e-6))

    def true_ns(self, sample: int) -> int:
        """Return the time of a sample in ns of the host's clock."""
        return self._begin_true_ns + round(sample * self._step_ns)

    def samples(self, first: int, number: int) -> bytes:
        """Return samples as a microphone delivers them."""
        since_ns = np.arange(first, first + number) * self._step_ns + self._begin_true_ns % 1_000_000_000
        is_click = since_ns % 1e9 < CLICK_SAMPLES * self._step_ns
        return np.where(is_click, CLICK, 0).astype("<i2").tobytes()


class SimulatedMicrophone:
    """A microphone that delivers late now and then, and on request loses a quarter of a second."""

    def __init__(self, clock: NodeClock, *, overrun: bool = False) -> None:
        """`overrun`: it loses samples in its fourth second."""
        self._clock, self._overrun = clock, overrun

    def listen(self, on_sound: OnSound, closing: threading.Event) -> None:
        """Deliver until `closing` is set; see `Microphone.listen`."""
        number = RATE_HZ * PERIOD_US // 1_000_000
        sound = SimulatedSound(self._true_ns())
        for first in count(0, number):
            due_ns = sound.true_ns(first + number) + DELAY_NS
            due_ns += max(0, STALL_NS - due_ns % STALL_EVERY_NS)
            if closing.wait(max(0, due_ns - self._true_ns()) / 1e9):
                return
            if not (self._overrun and LOST_FROM <= first < LOST_TO):
                on_sound(sound.samples(first, number), self._clock.now_ns())

    def _true_ns(self) -> int:
        return self._clock.true_from_local(self._clock.now_ns())


def partner_device(camera: str, classes: Path = Path("/sys/class/video4linux")) -> str:
    """Return the ALSA device of the microphone in the same USB device as a V4L2 camera.

    Raises CameraError if there is none.
    """
    node = classes / Path(camera).resolve().name / "device"
    cards = sorted(node.resolve().parent.glob("*/sound/card*"))
    if not cards:
        raise CameraError(
            f"{camera} has no microphone of its own", hint="name another one: arecord -l lists them"
        )
    return f"hw:{cards[0].name.removeprefix('card')}"


def open_microphone(text: str, spec: CameraSpec, clock: NodeClock) -> Microphone | None:
    """Return the microphone of a spec's option `sound`; None for one that the camera's driver has.

    Raises CameraError for a USB camera without one, NotAvailableError without arecord.
    """
    if text in (SIMULATED, OVERRUN):
        return SimulatedMicrophone(clock, overrun=text == OVERRUN)
    if text != OWN:
        return AlsaMicrophone(text, clock)
    return AlsaMicrophone(partner_device(spec.device), clock) if spec.kind == "v4l2" else None
