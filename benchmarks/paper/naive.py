"""Triggers of unsynchronized cameras, by their known mechanisms (the paper's Table I)."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import error_figures
from benchmarks.paper.trials import share_of
from benchmarks.paper.values import TABLE_1
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.console.terminal import talk

FRAME_MS = 33.0
"""Frame interval of a streaming camera, which takes the nearest frame, up to half a period off.

CameraX, "zero shutter lag"; Bucher, Cao, Viard and Guichard 2015 measured that the frame time limits the lag.
"""
HID_INTERVAL_MS = (7.5, 50.0)
"""Connection intervals of a Bluetooth remote, whose key waits for the next connection event.

The HID over GATT profile permits these intervals (Texas Instruments, SWRA715, 2021).
"""
BEACON_MS = 102.4
"""Beacon interval, for which an access point holds a datagram to a phone in power-saving mode.

IEEE 802.11-2020, 11.2; this is the typical interval of 100 time units.
"""

Draw = Callable[[random.Random], float]


def frame_grid_ms(rng: random.Random) -> float:
    """Return one camera's frame delay after the key."""
    return rng.uniform(-FRAME_MS / 2.0, FRAME_MS / 2.0)


def bluetooth_ms(rng: random.Random) -> float:
    """Return a phone's delay of a remote's key; each remote has its own interval."""
    return rng.uniform(0.0, rng.uniform(*HID_INTERVAL_MS))


def wifi_ms(rng: random.Random) -> float:
    """Return the delay of the message at the phone on the hotspot, asleep between beacons."""
    return rng.uniform(0.0, BEACON_MS) + PAPER_LINK.open().deliveries("to_client", 0, rng)[0] / 1e6


def nothing_ms(_: random.Random) -> float:
    """Return zero: both cameras see the same edge on a wire, or the hotspot's phone triggers itself."""
    return 0.0


@dataclass(frozen=True, slots=True)
class Trigger:
    """Delays of both cameras, from the key to the order to take an image."""

    one: Draw
    other: Draw

    def apart_ms(self, rng: random.Random) -> float:
        """Return the time difference of two cameras' images, in ms."""
        one_ms = self.one(rng) + frame_grid_ms(rng)
        return abs(self.other(rng) + frame_grid_ms(rng) - one_ms)


TRIGGERS: Mapping[str, Trigger] = {
    "wired": Trigger(nothing_ms, nothing_ms),
    "bluetooth": Trigger(bluetooth_ms, bluetooth_ms),
    "wifi": Trigger(nothing_ms, wifi_ms),
}
"""The paper's three triggers by name."""


TRIALS = 1000
FIGURES = {"mean_abs": "mean", "max": "max", "std": "std"}
"""Our names of the figures, and the paper's."""
NOTES = (
    "These are input polling, Bluetooth connection intervals, WiFi power saving and the frame grid, not the "
    "paper's table. The phones' camera apps add more delay.",
    "Failed triggers (the paper: 2 of 20 wired, 1 of 20 by Bluetooth) are not modelled.",
)


def draw_sizes(seed: str, count: int) -> dict[str, list[float]]:
    """Return the absolute time differences, in ms, by trigger."""
    sizes: dict[str, list[float]] = {}
    for name, trigger in TRIGGERS.items():
        rng = random.Random(f"{seed}/{name}")
        sizes[name] = [trigger.apart_ms(rng) for _ in range(count)]
    return sizes


def figures_of(sizes_ms: list[float]) -> dict[str, float]:
    """Return mean, maximum and standard deviation of time differences in ms."""
    figures = error_figures(sizes_ms)
    return {key: figures[key] for key in FIGURES}


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Compare the effect of known mechanisms with the paper's measurements."""
    count = share_of(TRIALS, share, least=200)
    talk(f"{count} triggers of each kind")
    sizes_ms = draw_sizes(str(seed), count)
    values = {
        f"{name}.{theirs}": figures_of(sizes)[ours]
        for name, sizes in sizes_ms.items()
        for ours, theirs in FIGURES.items()
    }
    return [
        Reproduction(
            of=TABLE_1,
            protocol=Measured(values, count, "only mechanisms with published numbers"),
            default=None,
            simulated="Everything: no phone was triggered.",
            notes=NOTES,
        )
    ]
