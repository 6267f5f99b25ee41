"""The leader's side of the reference broadcast: beacons that are due, and what those who heard them tell."""

from capture_app.sync.reference_broadcast.reference import LEAST_COMMON, Cell, Hearing, cells
from capture_app.sync.wire.beacon import AgreedArrival, ArrivalReport, Beacon, Group

_MS = 1_000_000
BEACON_EVERY_NS = 250 * _MS
AGREE_EVERY_NS = 500 * _MS
FORGOTTEN_NS = 3000 * _MS
"""Who has not told for so long what it heard does not count any more."""
REMEMBERED = 128
"""Only arrivals of so many newest beacons are believed: others were never sent, or long ago."""


class Broadcaster:
    """Beacons for a group of clients; without a group it does nothing. `now_ns` is leader time.

    A leader hears itself before the radio does, so what it hears does not count: its own camera gains
    nothing.
    """

    def __init__(self, leader: int, group: Group | None) -> None:
        self.group = group
        self._leader = leader
        self._sent = 0
        self._due_ns: int | None = None
        self._beacon: Beacon | None = None
        self._heard: dict[int, tuple[Hearing, int]] = {}
        """By the clients' numbers, with the time it was told."""
        self._cells: dict[int, Cell] = {}
        self._weigh_due_ns: int | None = None

    def take(self, heard: ArrivalReport, now_ns: int) -> AgreedArrival | None:
        """Take in what a client heard; return what it should have thought, None where nobody can tell."""
        arrivals = {n: at_ns for n, at_ns in heard.arrivals if self._sent - REMEMBERED < n <= self._sent}
        if self.group is None or not arrivals:
            return None
        hearing = Hearing(arrivals, heard.uncertainty_ns, heard.hard_bound_ns)
        self._heard[heard.client] = hearing, now_ns
        if self._weigh_due_ns is None or now_ns >= self._weigh_due_ns:
            self._weigh(now_ns)
        cell = self._cells.get(heard.client)
        place = None if cell is None else cell.place(hearing)
        if cell is None or place is None:
            return None
        newest = max(arrivals)
        return AgreedArrival(
            heard.client,
            newest,
            arrivals[newest] - round(place.late_ns),
            round(cell.uncertainty_ns + place.relative_uncertainty_ns),
            round(place.relative_uncertainty_ns),
        )

    def handle_timer(self, now_ns: int, listeners: int) -> None:
        """Prepare the next beacon when it is due; one alone has nobody to agree with."""
        if self.group is None:
            return
        if listeners < 2:
            self._due_ns = None
        elif self._due_ns is None or now_ns >= self._due_ns:
            self._sent += 1
            self._beacon = Beacon(self._leader, self._sent)
            self._due_ns = now_ns + BEACON_EVERY_NS

    def next_timer(self) -> int | None:
        """Leader time in ns at which `handle_timer` wants to be called, None for never."""
        return self._due_ns

    def beacon_to_send(self) -> Beacon | None:
        """Return the beacon that is due, for the group; one that was not taken in time is gone."""
        beacon, self._beacon = self._beacon, None
        return beacon

    def _weigh(self, now_ns: int) -> None:
        self._weigh_due_ns = now_ns + AGREE_EVERY_NS
        self._heard = {c: told for c, told in self._heard.items() if now_ns - told[1] < FORGOTTEN_NS}
        hearings = {c: told[0] for c, told in self._heard.items() if len(told[0].arrivals) >= LEAST_COMMON}
        self._cells = {client: cell for cell in cells(hearings) for client in cell.clients}
