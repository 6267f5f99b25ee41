"""Reference broadcast: clients that receive one packet at the same instant compare when that was.

After Elson, Girod and Estrin, *Fine-grained network time synchronization using reference broadcasts*, OSDI
2002. The time of sending drops out, and with it the delay from the leader; what remains is the difference
between the receivers. An error that all their clocks share cannot be seen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot
from statistics import median

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
class Lateness:
    """How much later than the consensus a client heard its newest beacon, and the 95 % error; in ns."""

    late_ns: float
    relative_uncertainty_ns: float


@dataclass(frozen=True, slots=True)
class Cell:
    """Clients that hear beacons at the same instants, and the consensus of when, in ns of leader time."""

    clients: tuple[int, ...]
    consensus_ns: Mapping[int, int]
    uncertainty_ns: float
    """95 % error of the consensus against the leader: that of the middle one of the clients."""

    def lateness_of(self, own: ClientArrivals) -> Lateness | None:
        """Compare a client of this cell with the consensus; None where too few beacons are common."""
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
        return Lateness(middle_ns, off_ns[int(0.95 * len(off_ns))])


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
    """Find each beacon's time and each client's lateness by median polish (Tukey 1977).

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
