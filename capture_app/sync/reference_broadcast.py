"""Reference broadcast: clients that receive one packet at the same instant compare when that was.

After Elson, Girod and Estrin, *Fine-grained network time synchronization using reference broadcasts*, OSDI
2002. The time of sending drops out, and with it the delay from the leader; what remains is the difference
between the receivers, and errors that all their clocks share. The leader sends beacons and compares when the
clients heard them; a client reports when, and moves its clock by the answers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot
from statistics import median

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.wire.messages import AgreedArrival, Arrival, ArrivalReport, Beacon, Group

LEAST_COMMON = 12
"""Beacons that two clients must both have heard to be compared: fewer may look alike by chance."""
SAME_INSTANT_NS = 20_000
"""One sigma of the difference of two arrivals, at most. One receiver of a packet scatters by 6 to 11 us
(Elson et al.), two by 9 to 16. Copies that go out one after the other scatter by 42: each waits for 0 to 15
slots of 9 us by chance."""
PLAUSIBLE_SHARE = 0.5
"""Largest plausible difference of two arrivals, as a share of the sum of both hard bounds."""
DECILES = 2.563
"""From the first decile to the last, in sigma, of normal noise."""
MOST_VOTERS = 50
"""Clients whose medians give the consensus: more make it no better."""
POLISH_ROUNDS = 10
SIGMA_FROM_MAD = 1.4826
"""One sigma of normal noise, in median absolute deviations."""
CLIP = 2.5
"""Residuals beyond this many sigma do not count."""


@dataclass(frozen=True, slots=True)
class ClientArrivals:
    """When a client heard each beacon, in leader time by its own estimate, and its errors; all in ns."""

    arrivals: Mapping[int, int]
    uncertainty_ns: float
    hard_bound_ns: float


@dataclass(frozen=True, slots=True)
class Cell:
    """Clients that hear beacons at the same instants, and the consensus of when, in ns of leader time."""

    clients: tuple[int, ...]
    consensus_ns: Mapping[int, int]
    uncertainty_ns: float
    """95 % error of the consensus against the leader: that of the middle one of the clients."""

    def offset_of(self, own: ClientArrivals) -> tuple[float, float] | None:
        """How much later than the consensus a client heard its newest beacon, and the 95 % error; in ns.

        None where too few beacons are common.
        """
        common = [n for n in own.arrivals if n in self.consensus_ns]
        if len(common) < LEAST_COMMON:
            return None
        newest_ns = own.arrivals[max(own.arrivals)]
        times_ns = [float(own.arrivals[n] - newest_ns) for n in common]
        late_ns = [float(own.arrivals[n] - self.consensus_ns[n]) for n in common]
        # Seconds ago it was late by something else: its estimate's skew is wrong, too.
        drift = theil_slope(times_ns, late_ns)
        late_now_ns = [late - drift * at for at, late in zip(times_ns, late_ns, strict=True)]
        middle_ns = clipped_mean(late_now_ns)
        # The mean of many is far better than each, but nobody can see by how much two receivers differ
        # always: it is taken to be as much as each of them differs by chance.
        off_ns = sorted(abs(value - middle_ns) for value in late_now_ns)
        return middle_ns, off_ns[int(0.95 * len(off_ns))]


def theil_slope(xs: Sequence[float], ys: Sequence[float]) -> float:
    """Return the median of the slopes of all pairs (Theil 1950): a third of the points may be anything."""
    points = list(zip(xs, ys, strict=True))
    slopes = [(v - y) / (u - x) for (x, y), (u, v) in combinations(points, 2) if u != x]
    return median(slopes) if slopes else 0.0


def clipped_mean(values: Sequence[float]) -> float:
    """Return a mean that outliers do not move."""
    centre = median(values)
    sigma = SIGMA_FROM_MAD * median([abs(value - centre) for value in values])
    kept = [value for value in values if abs(value - centre) <= CLIP * sigma]
    return sum(kept) / len(kept)


def receive_alike(one: ClientArrivals, other: ClientArrivals) -> bool:
    """Whether two clients may receive packets at the same instants, and comparing them helps.

    Arrivals that scatter by more than the two clocks' uncertainty would not improve them; arrivals that
    differ by more than their bounds allow are not of one instant.
    """
    differences_ns = [at_ns - other.arrivals[n] for n, at_ns in one.arrivals.items() if n in other.arrivals]
    if len(differences_ns) < LEAST_COMMON:
        return False
    differences_ns.sort()
    tenth = len(differences_ns) // 10
    scatter_ns = (differences_ns[-1 - tenth] - differences_ns[tenth]) / DECILES
    may_ns = PLAUSIBLE_SHARE * (one.hard_bound_ns + other.hard_bound_ns)
    return (
        scatter_ns <= min(SAME_INSTANT_NS, hypot(one.uncertainty_ns, other.uncertainty_ns))
        and abs(median(differences_ns)) <= may_ns
    )


def group_into_cells(arrivals_by_client: Mapping[int, ClientArrivals]) -> list[Cell]:
    """Group clients, by number, into cells of two or more; each is compared with a cell's best listener."""
    groups: list[list[int]] = []
    for client in sorted(
        arrivals_by_client, key=lambda number: (-len(arrivals_by_client[number].arrivals), number)
    ):
        for group in groups:
            if receive_alike(arrivals_by_client[client], arrivals_by_client[group[0]]):
                group.append(client)
                break
        else:
            groups.append([client])
    return [_find_consensus(group, arrivals_by_client) for group in groups if len(group) > 1]


def _find_consensus(group: Sequence[int], arrivals_by_client: Mapping[int, ClientArrivals]) -> Cell:
    """Find each beacon's time and each client's offset by median polish (Tukey 1977).

    Medians over clients and over beacons in turn: a minority with false times, or missing arrivals, change
    little.
    The middle client is late by 0.
    """
    voters = [arrivals_by_client[client].arrivals for client in group[:MOST_VOTERS]]
    votes: dict[int, int] = {}
    for arrivals in voters:
        for number in arrivals:
            votes[number] = votes.get(number, 0) + 1
    # Floats are for differences only: leader times may be too large for them.
    base_ns = {n: at_ns for arrivals in reversed(voters) for n, at_ns in arrivals.items() if votes[n] > 1}
    rows = [
        {n: float(at_ns - base_ns[n]) for n, at_ns in arrivals.items() if n in base_ns} for arrivals in voters
    ]
    late = [0.0] * len(rows)
    times: dict[int, float] = {}
    for _ in range(POLISH_ROUNDS):
        before, columns = late, {n: list[float]() for n in base_ns}
        for row, late_ns in zip(rows, late, strict=True):
            for n, at_ns in row.items():
                columns[n].append(at_ns - late_ns)
        times = {n: median(column) for n, column in columns.items()}
        late = [median([at_ns - times[n] for n, at_ns in row.items()]) for row in rows]
        common = median(late)
        late = [late_ns - common for late_ns in late]
        times = {n: at_ns + common for n, at_ns in times.items()}
        if late == before:
            break
    return Cell(
        tuple(group),
        {n: base_ns[n] + round(at_ns) for n, at_ns in times.items()},
        median([arrivals_by_client[client].uncertainty_ns for client in group]),
    )


BEACON_EVERY_NS = 250_000_000
REGROUP_EVERY_NS = 500_000_000
FORGOTTEN_NS = 3_000_000_000
"""Reports of arrivals older than this do not count."""
REMEMBERED = 128
"""Only arrivals of so many newest beacons count: others were never sent, or long ago."""


class Broadcaster:
    """Beacons for a group of clients; without a group it does nothing. `now_ns` is leader time.

    A leader receives its own beacons before they are in the air, so its own camera takes no part.
    """

    def __init__(self, leader: int, group: Group | None, *, fully: bool = True) -> None:
        """`fully`: move clients as far as their hard bounds allow, not only within their own 95 % errors."""
        self.group, self._fully = group, fully
        self._leader = leader
        self._sent = 0
        self.due_ns: int | None = None
        """Leader time at which `handle_timer` wants to be called, None for never."""
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
        offset = None if cell is None else cell.offset_of(own)
        if cell is None or offset is None:
            return None
        newest, (late_ns, relative_ns) = max(arrivals), offset
        # Without being asked nobody is moved further than he says himself that he may be off.
        most_ns = report.hard_bound_ns if self._fully else report.uncertainty_ns
        moved_ns = min(max(late_ns, -most_ns), most_ns)
        relative_ns += abs(late_ns - moved_ns)
        return AgreedArrival(
            report.client,
            newest,
            arrivals[newest] - round(moved_ns),
            round(cell.uncertainty_ns + relative_ns),
            round(relative_ns),
        )

    def handle_timer(self, now_ns: int, listeners: int) -> None:
        """Prepare the next beacon when it is due, if there are two listeners or more."""
        if self.group is None:
            return
        if listeners < 2:
            self.due_ns = None
        elif self.due_ns is None or now_ns >= self.due_ns:
            self._sent += 1
            self._beacon = Beacon(self._leader, self._sent)
            self.due_ns = now_ns + BEACON_EVERY_NS

    def beacon_to_send(self) -> Beacon | None:
        """Return the beacon to send to the group, once."""
        beacon, self._beacon = self._beacon, None
        return beacon

    def _regroup(self, now_ns: int) -> None:
        self._regroup_due_ns = now_ns + REGROUP_EVERY_NS
        self._reports = {c: one for c, one in self._reports.items() if now_ns - one[1] < FORGOTTEN_NS}
        known = {c: own for c, (own, _) in self._reports.items() if len(own.arrivals) >= LEAST_COMMON}
        self._cells = {client: cell for cell in group_into_cells(known) for client in cell.clients}


KEPT_BEACONS = 24
"""Newest beacons that are reported: six seconds at four a second."""
MAX_AGE_NS = 10_000_000_000
"""Older arrivals and answers do not count: the clock goes back to its own estimate."""
REPORT_EVERY_NS = 1_000_000_000
SLEW = 100e-6
"""How fast a correction changes, in ns per ns: as fast as the greatest skew of a clock."""


class Listener:
    """Beacons heard from one leader; times in ns of the node's own clock unless they say leader."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything: there is another leader, or a clock stepped."""
        self.corrected: TimeMap | None = None
        """The newest estimate, moved; None where no answer came, or all are too old."""
        self._arrivals: dict[int, int] = {}
        """By number, the one that came first in front."""
        self._reported_ns: int | None = None
        self._new_arrivals = False
        self._answer: tuple[int, AgreedArrival] | None = None
        """With the local time at which its beacon was heard."""

    def add_arrival(self, number: int, local_ns: int) -> None:
        """Note when a beacon arrived; of copies the first counts."""
        if number in self._arrivals:
            return
        self._arrivals[number] = local_ns
        self._new_arrivals = True
        if len(self._arrivals) > KEPT_BEACONS:
            del self._arrivals[next(iter(self._arrivals))]

    def next_timer(self) -> int | None:
        """When `report_due` wants to be called, None for not before another beacon."""
        if not self._new_arrivals or len(self._arrivals) < LEAST_COMMON:
            return None
        return -(2**62) if self._reported_ns is None else self._reported_ns + REPORT_EVERY_NS

    def report_due(self, client: int, own: TimeMap, now_ns: int) -> ArrivalReport | None:
        """Return the arrivals in leader time by the client's own estimate, None where no report is due.

        That estimate is not corrected: no client shall get its correction back as another's measurement.
        """
        due_ns = self.next_timer()
        if due_ns is None or now_ns < due_ns:
            return None
        self._reported_ns, self._new_arrivals = now_ns, False
        arrivals: list[Arrival] = []
        for number, local_ns in sorted(self._arrivals.items()):
            if 0 <= now_ns - local_ns <= MAX_AGE_NS:
                arrivals.append((number, own.leader_from_local(local_ns)))
            else:
                del self._arrivals[number]
        uncertainty_ns, hard_bound_ns = own.uncertainty_at(now_ns), own.hard_bound_at(now_ns)
        return ArrivalReport(client, round(uncertainty_ns), round(hard_bound_ns), tuple(arrivals))

    def accept(self, answer: AgreedArrival) -> None:
        """Take the leader's answer for a beacon that was heard here; late answers change nothing."""
        local_ns = self._arrivals.get(answer.number)
        if local_ns is not None and (self._answer is None or local_ns >= self._answer[0]):
            self._answer = local_ns, answer

    def correct(self, own: TimeMap, now_ns: int) -> TimeMap:
        """Move an estimate slowly towards the leader's answer, never by more than its hard bound.

        `own` is the newest estimate, at the epoch `now_ns`. Without an answer it is returned as it is.
        """
        answer, goal_ns = self._usable_answer(own, now_ns), 0
        if answer is None and self.corrected is None:
            return own
        if answer is not None:
            goal_ns = answer[1].leader_ns - own.leader_from_local(answer[0])
        last = self.corrected or own
        # From where the clock stood, not from the newest estimate: that one jumps with each better message.
        stood_ns = last.leader_from_local(now_ns) - own.leader_from_local(now_ns)
        step_ns, bound_ns = round(SLEW * max(0, now_ns - last.epoch_local_ns)), int(own.hard_bound_ns)
        correction_ns = stood_ns + min(max(goal_ns - stood_ns, -step_ns), step_ns)
        correction_ns = min(max(correction_ns, -bound_ns), bound_ns)
        if answer is None and correction_ns == 0:
            self.corrected = None
            return own
        uncertainty_ns = relative_uncertainty_ns = own.uncertainty_ns + abs(correction_ns)
        if answer is not None:
            # The skew's error has moved the clock since.
            left_ns = abs(goal_ns - correction_ns) + own.skew_uncertainty * (now_ns - answer[0])
            uncertainty_ns = min(uncertainty_ns, answer[1].uncertainty_ns + left_ns)
            relative_uncertainty_ns = answer[1].relative_uncertainty_ns + left_ns
        self.corrected = own.corrected_by(correction_ns, uncertainty_ns, relative_uncertainty_ns)
        return self.corrected

    def _usable_answer(self, own: TimeMap, now_ns: int) -> tuple[int, AgreedArrival] | None:
        """The answer, unless it is old or the hard bound excludes it."""
        if self._answer is None or not 0 <= now_ns - self._answer[0] <= MAX_AGE_NS:
            return None
        local_ns, answer = self._answer
        wrong_ns = abs(answer.leader_ns - own.leader_from_local(local_ns))
        return self._answer if wrong_ns <= own.hard_bound_at(local_ns) else None
