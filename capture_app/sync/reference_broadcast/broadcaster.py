"""The leader's side of the reference broadcast: it sends beacons and compares when the clients heard them."""

from capture_app.sync.reference_broadcast.cells import LEAST_COMMON, Cell, ClientArrivals, group_into_cells
from capture_app.sync.wire.beacon import AgreedArrival, ArrivalReport, Beacon, Group

_MS = 1_000_000
BEACON_EVERY_NS = 250 * _MS
REGROUP_EVERY_NS = 500 * _MS
FORGOTTEN_NS = 3000 * _MS
"""Reports of arrivals older than this do not count."""
REMEMBERED = 128
"""Only arrivals of so many newest beacons count: others were never sent, or long ago."""


class Broadcaster:
    """Beacons for a group of clients; without a group it does nothing. `now_ns` is leader time.

    A leader receives its own beacons before they are in the air, so its own camera takes no part.
    """

    def __init__(self, leader: int, group: Group | None) -> None:
        self.group = group
        self._leader = leader
        self._sent = 0
        self._due_ns: int | None = None
        self._beacon: Beacon | None = None
        self._reports: dict[int, tuple[ClientArrivals, int]] = {}
        """Newest report of each client by its number, with the time at which it came."""
        self._cells: dict[int, Cell] = {}
        self._regroup_due_ns: int | None = None

    def answer(self, report: ArrivalReport, now_ns: int) -> AgreedArrival | None:
        """Return when a client should have heard its newest beacon, None where no other client can tell."""
        arrivals = {n: at_ns for n, at_ns in report.arrivals if self._sent - REMEMBERED < n <= self._sent}
        if self.group is None or not arrivals:
            return None
        own = ClientArrivals(arrivals, report.uncertainty_ns, report.hard_bound_ns)
        self._reports[report.client] = own, now_ns
        if self._regroup_due_ns is None or now_ns >= self._regroup_due_ns:
            self._regroup(now_ns)
        cell = self._cells.get(report.client)
        lateness = None if cell is None else cell.lateness_of(own)
        if cell is None or lateness is None:
            return None
        newest = max(arrivals)
        return AgreedArrival(
            report.client,
            newest,
            arrivals[newest] - round(lateness.late_ns),
            round(cell.uncertainty_ns + lateness.relative_uncertainty_ns),
            round(lateness.relative_uncertainty_ns),
        )

    def handle_timer(self, now_ns: int, listeners: int) -> None:
        """Prepare the next beacon when it is due, if there are two listeners or more."""
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
        """Return the beacon to send to the group, once."""
        beacon, self._beacon = self._beacon, None
        return beacon

    def _regroup(self, now_ns: int) -> None:
        self._regroup_due_ns = now_ns + REGROUP_EVERY_NS
        self._reports = {c: one for c, one in self._reports.items() if now_ns - one[1] < FORGOTTEN_NS}
        known = {c: own for c, (own, _) in self._reports.items() if len(own.arrivals) >= LEAST_COMMON}
        self._cells = {client: cell for cell in group_into_cells(known) for client in cell.clients}
