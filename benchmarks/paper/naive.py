"""Triggers sent to cameras that are not synchronized, by their known mechanisms (the paper's Table I)."""

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
"""A camera that streams takes the frame nearest to the key: up to half a period early or late (CameraX, "zero
shutter lag"; Bucher, Cao, Viard and Guichard 2015 measured that lag to be limited by the frame time)."""
HID_INTERVAL_MS = (7.5, 50.0)
"""A Bluetooth remote's key waits for its next connection event; the HID over GATT profile allows these
intervals (Texas Instruments, SWRA715, 2021)."""
BEACON_MS = 102.4
"""For a phone that saves power an access point keeps a datagram until its next beacon (IEEE 802.11-2020,
11.2); this is the usual interval of 100 time units."""

Draw = Callable[[random.Random], float]


def frame_grid_ms(rng: random.Random) -> float:
    """How much later than the key one camera's frame is."""
    return rng.uniform(-FRAME_MS / 2.0, FRAME_MS / 2.0)


def bluetooth_ms(rng: random.Random) -> float:
    """How much later a phone hears of a remote's key; each remote has an interval of its own."""
    return rng.uniform(0.0, rng.uniform(*HID_INTERVAL_MS))


def wifi_ms(rng: random.Random) -> float:
    """How much later the message is at the phone that joined the hotspot, asleep between beacons."""
    return rng.uniform(0.0, BEACON_MS) + PAPER_LINK.open().deliveries("to_client", 0, rng)[0] / 1e6


def nothing_ms(_: random.Random) -> float:
    """Both see the same edge on their wires; the hotspot's phone tells itself at once."""
    return 0.0


@dataclass(frozen=True, slots=True)
class Trigger:
    """What one and the other camera wait for, from the key to the order to take a picture."""

    one: Draw
    other: Draw

    def apart_ms(self, rng: random.Random) -> float:
        """How far apart two cameras' pictures are, in ms."""
        one_ms = self.one(rng) + frame_grid_ms(rng)
        return abs(self.other(rng) + frame_grid_ms(rng) - one_ms)


TRIGGERS: Mapping[str, Trigger] = {
    "wired": Trigger(nothing_ms, nothing_ms),
    "bluetooth": Trigger(bluetooth_ms, bluetooth_ms),
    "wifi": Trigger(nothing_ms, wifi_ms),
}
"""The paper's three by their names."""


TRIALS = 1000
FIGURES = {"mean_abs": "mean", "max": "max", "std": "std"}
"""Ours and the paper's names."""
NOTES = (
    "Modelled from mechanisms that have published numbers, none of them the paper's table: input polling, "
    "Bluetooth connection intervals, WiFi power saving, the frame grid. What the paper's phones have beyond "
    "that, their camera apps added.",
    "Failed triggers (the paper: 2 of 20 wired, 1 of 20 by Bluetooth) have no such mechanism and are not "
    "modelled.",
)


def draw_sizes(seed: str, count: int) -> dict[str, list[float]]:
    """How far apart pictures are, in ms, by trigger."""
    sizes: dict[str, list[float]] = {}
    for name, trigger in TRIGGERS.items():
        rng = random.Random(f"{seed}/{name}")
        sizes[name] = [trigger.apart_ms(rng) for _ in range(count)]
    return sizes


def figures_of(sizes_ms: list[float]) -> dict[str, float]:
    """Mean, largest and deviation of distances in ms."""
    figures = error_figures(sizes_ms)
    return {key: figures[key] for key in FIGURES}


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Set what known mechanisms explain beside what the paper measured."""
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
            simulated="Everything: no phone was triggered. The paper's figures stand as it gives them.",
            notes=NOTES,
        )
    ]
