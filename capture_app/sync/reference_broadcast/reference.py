"""Reference broadcast: clients that hear one packet at one instant agree on when that was.

After Elson, Girod and Estrin, *Fine-grained network time synchronization using reference broadcasts*, OSDI
2002. When the packet was sent drops out, and with it the way from the leader; what remains is how differently
the clients hear. What is wrong in all their clocks alike cannot be seen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot
from statistics import median

from capture_app.sync.clock.robust_slope import SIGMA_FROM_MAD

LEAST_COMMON = 12
"""Beacons that two must both have heard before anything is said of them: fewer may look alike by chance."""
SAME_INSTANT_NS = 20_000
"""One sigma of the difference of two arrivals, at most. One receiver of a packet scatters by 6 to 11 us
(Elson et al.), two by 9 to 16. Copies that go out one after the other scatter by 42: each waits for 0 to 15
slots of 9 us by chance."""
PLAUSIBLE_SHARE = 0.5
"""Of what the bounds allow two clocks to differ: where packets seem heard further apart, they likely are."""
DECILES = 2.563
"""From the first decile to the last, in sigma, of normal noise."""
MOST_VOTERS = 50
"""More clients make the medians no better; the others listen to these."""
ROUNDS = 10
CLIP = 2.5
"""Residuals beyond this many sigma do not count."""


@dataclass(frozen=True, slots=True)
class Hearing:
    """When a client heard each beacon, leader time by its own estimate, and that one's errors; all in ns."""

    arrivals: Mapping[int, int]
    uncertainty_ns: float
    hard_bound_ns: float


@dataclass(frozen=True, slots=True)
class Place:
    """How much later than agreed a client thinks it heard its newest beacon, and the 95 % error; in ns."""

    late_ns: float
    relative_uncertainty_ns: float


@dataclass(frozen=True, slots=True)
class Cell:
    """Clients that hear the same beacons at the same instants, and when they agree that was, leader ns."""

    clients: tuple[int, ...]
    agreed_ns: Mapping[int, int]
    uncertainty_ns: float
    """95 % error of the agreed times against the leader: that of the middle one of the clients."""

    def place(self, hearing: Hearing) -> Place | None:
        """Place a client of this cell; None where it heard too few of the beacons that were agreed on."""
        common = [n for n in hearing.arrivals if n in self.agreed_ns]
        if len(common) < LEAST_COMMON:
            return None
        newest_ns = hearing.arrivals[max(hearing.arrivals)]
        times_ns = [float(hearing.arrivals[n] - newest_ns) for n in common]
        late_ns = [float(hearing.arrivals[n] - self.agreed_ns[n]) for n in common]
        # Seconds ago it was late by something else: its estimate's skew is wrong, too.
        drift = slope(times_ns, late_ns)
        late_now_ns = [late - drift * at for at, late in zip(times_ns, late_ns, strict=True)]
        middle_ns = middle(late_now_ns)
        # The mean of many is far better than each, but nobody can see by how much two receivers differ
        # always: it is taken to be as much as each of them differs by chance.
        off_ns = sorted(abs(value - middle_ns) for value in late_now_ns)
        return Place(middle_ns, off_ns[int(0.95 * len(off_ns))])


def slope(xs: Sequence[float], ys: Sequence[float]) -> float:
    """Return the median of the slopes of all pairs (Theil 1950): a third of the points may be anything."""
    points = list(zip(xs, ys, strict=True))
    slopes = [(v - y) / (u - x) for (x, y), (u, v) in combinations(points, 2) if u != x]
    return median(slopes) if slopes else 0.0


def middle(values: Sequence[float]) -> float:
    """Return a mean that outliers do not move."""
    centre = median(values)
    sigma = SIGMA_FROM_MAD * median([abs(value - centre) for value in values])
    kept = [value for value in values if abs(value - centre) <= CLIP * sigma]
    return sum(kept) / len(kept)


def hear_alike(one: Hearing, other: Hearing) -> bool:
    """Whether two clients may hear the same packets at the same instants, and it is worth to compare them.

    Arrivals that scatter by more than the two clocks are thought to differ would mend nothing; arrivals that
    differ by more than the clocks may are not of one instant.
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


def cells(hearings: Mapping[int, Hearing]) -> list[Cell]:
    """Sort clients, by number, into cells of two or more; each is compared with the best hearer of a cell."""
    groups: list[list[int]] = []
    for client in sorted(hearings, key=lambda number: (-len(hearings[number].arrivals), number)):
        for group in groups:
            if hear_alike(hearings[client], hearings[group[0]]):
                group.append(client)
                break
        else:
            groups.append([client])
    return [_agree(group, hearings) for group in groups if len(group) > 1]


def _agree(group: Sequence[int], hearings: Mapping[int, Hearing]) -> Cell:
    """Find each beacon's time and each client's lateness by median polish (Tukey 1977).

    Medians over clients and over beacons in turn: a minority that lies, or missing arrivals, move nothing.
    The middle client is late by 0.
    """
    voters = [hearings[client].arrivals for client in group[:MOST_VOTERS]]
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
    for _ in range(ROUNDS):
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
        median([hearings[client].uncertainty_ns for client in group]),
    )
