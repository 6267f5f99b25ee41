"""WiFi links whose delays come in spells, in virtual time, and recorded links replayed.

`python -m benchmarks.simulated.link_spells TRACE` prints the asymmetry of a recorded link.
"""

import random
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from pathlib import Path
from statistics import fmean

from benchmarks.simulated.links import Direction, Link
from benchmarks.simulated.wireless import WIFI, GammaDelay, TroubleSpells, WirelessLink
from capture_app.console.terminal import print_line

MS, S = 1_000_000, 1_000_000_000
RECORDED_INTERVAL_NS = 200 * MS
"""Interval of the exchanges of the recorded link (roc-streaming)."""
WINDOWS_S = (4, 10, 30)
"""Windows in which a recording's asymmetry is printed; a node's clock filter looks back 30 s at most."""
BEACON_NS = 102_400_000
"""Interval of an access point's beacons (100 time units): a dozing client gets its messages then."""


@dataclass(frozen=True, slots=True)
class Scattered(TroubleSpells):
    """Exponential delays of a mean in ns, and loss."""

    extra_ns: int = 15 * MS
    loss: float = 0.1


@dataclass(frozen=True, slots=True)
class Raised(TroubleSpells):
    """A floor that is higher in one direction, as after a change of the radio's rate or mode."""

    extra_ns: int = 329_000
    direction: Direction = "to_client"

    def added_ns(
        self, direction: Direction, since_ns: float, true_ns: int, rng: random.Random
    ) -> float | None:
        """Return the additional delay in ns."""
        return self.extra_ns if direction == self.direction else 0.0


@dataclass(frozen=True, slots=True)
class Silent(TroubleSpells):
    """Nothing arrives: the client roams from one access point to another."""

    def added_ns(
        self, direction: Direction, since_ns: float, true_ns: int, rng: random.Random
    ) -> float | None:
        """Return None: the message is lost."""
        return None


@dataclass(frozen=True, slots=True)
class Microwave(TroubleSpells):
    """An oven transmits for 8 ms of each 20 (half a cycle of the mains); messages wait for its end."""

    on_ns: int = 8 * MS
    cycle_ns: int = 20 * MS

    def added_ns(
        self, direction: Direction, since_ns: float, true_ns: int, rng: random.Random
    ) -> float | None:
        """Return the additional delay in ns."""
        return max(0, self.on_ns - true_ns % self.cycle_ns) * (1.0 + 0.1 * rng.random())


@dataclass(frozen=True, slots=True)
class PowerSave(TroubleSpells):
    """The client dozes: messages to it wait for the next beacon, and come in a batch."""

    def added_ns(
        self, direction: Direction, since_ns: float, true_ns: int, rng: random.Random
    ) -> float | None:
        """Return the additional delay in ns."""
        return 0.0 if direction == "to_leader" else BEACON_NS - true_ns % BEACON_NS


@dataclass(frozen=True, slots=True)
class FillingQueue(TroubleSpells):
    """Bufferbloat: a queue in one direction fills at this rate (ns per ns) up to a maximum, as a download."""

    rate: float = 0.1
    max_ns: int = 200 * MS

    def added_ns(
        self, direction: Direction, since_ns: float, true_ns: int, rng: random.Random
    ) -> float | None:
        """Return the additional delay in ns."""
        filled_ns = min(self.rate * since_ns, self.max_ns)
        return 0.0 if direction == "to_leader" else filled_ns * rng.uniform(0.9, 1.0)


def _in_spells(spells: TroubleSpells) -> WirelessLink:
    return WirelessLink(WIFI.to_leader, WIFI.to_client, spells=spells)


RECORDED_SPELLS = WirelessLink(
    GammaDelay(782_000, 1_120_000, 2.0, 0.017, 5 * MS, 170 * MS),
    GammaDelay(782_000, 1_120_000, 2.0, 0.012, 5 * MS, 400 * MS),
    spells=Raised(calm_ns=18_800 * MS, trouble_ns=25_700 * MS, extra_ns=329_000),
)
"""The chain of the recorded link (roc-streaming): two floors, and the mean times for which it has each."""
_LINKS: dict[str, Link] = {
    "independent": WIFI,
    "two states as recorded": RECORDED_SPELLS,
    "the same, 20 times as often": replace(
        RECORDED_SPELLS, spells=Raised(calm_ns=940 * MS, trouble_ns=1_285 * MS, extra_ns=329_000)
    ),
    "trouble of 0.3 s": _in_spells(Scattered(500 * MS, 300 * MS)),
    "roaming": _in_spells(Silent(8 * S, 2 * S)),
    "microwave oven": _in_spells(Microwave(5 * S, 5 * S)),
    "power save": _in_spells(PowerSave(2 * S, 1 * S)),
    "bufferbloat": _in_spells(FillingQueue(3 * S, 2 * S)),
}
"""Links with a memory, by name; the first has none, to compare with."""
DrawLink = Callable[[random.Random], Link]


def _same(link: Link, _: random.Random) -> Link:
    return link


LAWS: dict[str, DrawLink] = {name: partial(_same, link) for name, link in _LINKS.items()}
"""The same links, drawn as those of recordings are."""


@dataclass(frozen=True, slots=True)
class ReplayedDelay:
    """Recorded delays in ns, one for each `every_ns` of true time, in a loop from index `start`."""

    delays_ns: tuple[int, ...]
    every_ns: int
    start: int = 0

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay recorded for that time, in ns."""
        return self.delays_ns[(self.start + true_ns // self.every_ns) % len(self.delays_ns)]


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Rows of a recording in random order: the same delays without their memory."""

    delays_ns: tuple[int, ...]

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        return rng.choice(self.delays_ns)


def read_recording(path: Path) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the delays in ns to the leader and to the client: two columns in us, one exchange a row."""
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    there, back = ([round(float(row[column]) * 1000) for row in rows] for column in (0, 1))
    return tuple(there), tuple(back)


def recorded_laws(path: Path) -> dict[str, DrawLink]:
    """Return a recording in random order, in order, and in order 20 times as fast; each starts anywhere."""
    there, back = read_recording(path)
    return {
        "recording, random order": partial(_same, Link(_Drawn(there), _Drawn(back))),
        "recording, in order": partial(_from_anywhere, there, back, RECORDED_INTERVAL_NS),
        "recording, 20 times as fast": partial(_from_anywhere, there, back, RECORDED_INTERVAL_NS // 20),
    }


def _from_anywhere(there: tuple[int, ...], back: tuple[int, ...], every_ns: int, rng: random.Random) -> Link:
    start = rng.randrange(len(there))
    return Link(ReplayedDelay(there, every_ns, start), ReplayedDelay(back, every_ns, start))


def asymmetries(there_ns: tuple[int, ...], back_ns: tuple[int, ...], rows: int) -> list[float]:
    """Return a recording's asymmetry in each window of this many rows, ascending and without signs.

    It is half the difference of the minimum delays, as a fraction of half the minimum round trip.
    """
    starts = range(0, len(there_ns) - rows + 1, rows)
    floors = [(min(there_ns[i : i + rows]), min(back_ns[i : i + rows])) for i in starts]
    return sorted(abs(there - back) / (there + back) for there, back in floors)


if __name__ == "__main__":
    for seconds in WINDOWS_S:
        found = asymmetries(*read_recording(Path(sys.argv[1])), seconds * S // RECORDED_INTERVAL_NS)
        rms, most = sqrt(fmean(one**2 for one in found)), found[int(0.95 * len(found))]
        print_line(
            f"asymmetry in windows of {seconds} s: {rms:.3f} of half the round trip (rms), 95 %: {most:.3f}"
        )
