"""What is known to make two cameras differ that are triggered and not synchronized, each with its source.

None of these numbers is the paper's, but for the frame period and the link: they say how much of what it
measured these mechanisms explain. What a phone's camera app adds between a key and a picture (autofocus,
exposure, its own queues) has no published law that we know of; it is left out, and said so.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from capture_app.simulation.links import Channel
from capture_app.simulation.paper_link import PAPER_LINK

FRAME_MS = 33.0
"""A camera that streams takes the frame nearest to the key: up to half a period early or late (CameraX, "zero
shutter lag"; Bucher, Cao, Viard and Guichard 2015 measured that lag to be limited by the frame time)."""
USB_POLL_MS = 8.0
"""A host asks a low-speed keyboard or mouse each 8 ms (Wimmer, Schmid and Bockes 2019, 36 devices)."""
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


def usb_poll_ms(rng: random.Random) -> float:
    """How much later a host hears of a key."""
    return rng.uniform(0.0, USB_POLL_MS)


def bluetooth_ms(rng: random.Random) -> float:
    """How much later a phone hears of a remote's key; each remote has an interval of its own."""
    return rng.uniform(0.0, rng.uniform(*HID_INTERVAL_MS))


def wifi_ms(rng: random.Random) -> float:
    """How much later the message is at the phone that joined the hotspot, asleep between beacons."""
    return rng.uniform(0.0, BEACON_MS) + Channel(PAPER_LINK).deliveries("to_client", 0, rng)[0] / 1e6


def nothing_ms(_: random.Random) -> float:
    """Both see the same edge on their wires; the hotspot's phone tells itself at once."""
    return 0.0


@dataclass(frozen=True, slots=True)
class Trigger:
    """What one and the other camera wait for, from the key to the order to take a picture."""

    title: str
    mechanisms: str
    one: Draw
    other: Draw

    def apart_ms(self, rng: random.Random) -> float:
        """How far apart two cameras' pictures are, in ms."""
        one_ms = self.one(rng) + frame_grid_ms(rng)
        return abs(self.other(rng) + frame_grid_ms(rng) - one_ms)


TRIGGERS: Mapping[str, Trigger] = {
    "wired": Trigger("selfie stick, audio splitter", "frame grid", nothing_ms, nothing_ms),
    "bluetooth": Trigger(
        "two Bluetooth remotes, one button", "connection intervals, frame grid", bluetooth_ms, bluetooth_ms
    ),
    "wifi": Trigger("message over WiFi", "sleep until a beacon, link, frame grid", nothing_ms, wifi_ms),
    "usb": Trigger("two USB keys, one button", "input polling, frame grid", usb_poll_ms, usb_poll_ms),
}
"""The paper's three by their names, and one more for cameras on computers."""
