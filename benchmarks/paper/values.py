"""The paper's own numbers, by table and figure.

Ansari, Wadhwa, Garg, Chen: Wireless Software Synchronization of Multiple Distributed Cameras, ICCP 2019, and
its supplement. `TABLE_2["total.max"]` is a number; `reproduction.py` adds ours.
"""

import msgspec


class PaperValue(msgspec.Struct, frozen=True):
    """A number of the paper; None if the paper does not state what we measure."""

    name: str
    label: str
    unit: str
    """us, ms, s, %; empty for counts."""
    value: float | None
    at_most: bool = False
    """Whether the paper gives a bound."""
    less_is_better: bool = False
    headline: bool = False
    """Whether it is in the table at the top of the page."""


class PaperTable(msgspec.Struct, frozen=True):
    """A table of the paper, or numbers that belong together in its text."""

    key: str
    title: str
    place: str
    values: tuple[PaperValue, ...]

    def __getitem__(self, name: str) -> float:
        """Return a number by its name; raises KeyError if the paper has none."""
        for value in self.values:
            if value.name == name and value.value is not None:
                return value.value
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all numbers, in order."""
        return tuple(value.name for value in self.values)


class PaperFigure(PaperTable, frozen=True):
    """A figure of the paper, with its numbers."""


def _errors(
    name: str, label: str, unit: str, largest: float, mean: float, std: float, *, headline: bool = True
) -> list[PaperValue]:
    """Return the paper's three figures of errors: maximum, mean absolute value, standard deviation."""
    return [
        PaperValue(f"{name}.mean", f"{label}, mean", unit, mean, less_is_better=True, headline=headline),
        PaperValue(f"{name}.max", f"{label}, largest", unit, largest, less_is_better=True, headline=headline),
        PaperValue(f"{name}.std", f"{label}, standard deviation", unit, std, less_is_better=True),
    ]


def _triggers(name: str, label: str, largest: float, mean: float, std: float) -> list[PaperValue]:
    return [
        PaperValue(f"{name}.mean", f"{label}, mean", "ms", mean, headline=True),
        PaperValue(f"{name}.max", f"{label}, largest", "ms", largest),
        PaperValue(f"{name}.std", f"{label}, standard deviation", "ms", std),
    ]


TABLE_1 = PaperTable(
    "table-1",
    "Pictures triggered without synchronization",
    "Table I",
    (
        *_triggers("wired", "a selfie stick", 180.0, 103.0, 50.0),
        *_triggers("bluetooth", "Bluetooth remotes", 200.0, 69.0, 65.0),
        *_triggers("wifi", "a message over WiFi", 677.0, 123.0, 84.0),
        *_errors("ours", "this method (Table II)", "ms", 0.121, 0.032, 0.025, headline=False),
    ),
)
TABLE_2 = PaperTable(
    "table-2",
    "Two phones, synchronized",
    "Table II",
    (
        *_errors("total", "total error", "us", 121.0, 32.0, 25.0),
        *_errors("phase", "its part from the phase", "us", 21.0, 7.0, 5.0),
        PaperValue(
            "clock.mean", "its part from the clock, mean", "us", 32.0, at_most=True, less_is_better=True
        ),
        PaperValue(
            "clock.max", "its part from the clock, largest", "us", 121.0, at_most=True, less_is_better=True
        ),
        PaperValue(
            "clock.std",
            "its part from the clock, standard deviation",
            "us",
            25.0,
            at_most=True,
            less_is_better=True,
        ),
    ),
)
WORST_PAIR = PaperTable(
    "worst-pair",
    "More than two phones",
    "section 6",
    (
        PaperValue("pair.max", "worst pair of all trials", "us", 242.0, less_is_better=True, headline=True),
        PaperValue("pair.mean", "worst pair of a trial, mean", "us", None, less_is_better=True),
    ),
)
TABLE_3 = PaperTable(
    "table-3",
    "Messages between leader and client",
    "Table III",
    (
        PaperValue("to_client.mean", "leader to client, mean", "us", 1133.0),
        PaperValue("to_leader.mean", "client to leader, mean", "us", 1878.0),
        PaperValue("difference.mean", "difference of the two means", "us", 746.0),
        PaperValue("round_trip.mean", "round trip, mean", "us", 3012.0),
        PaperValue("bias.mean", "error of the mean filter", "us", 372.0, less_is_better=True),
        PaperValue("to_client.least", "leader to client, of the quickest message", "us", 517.0),
        PaperValue("to_leader.least", "client to leader, of the quickest message", "us", 479.0),
        PaperValue("difference.least", "difference of these two", "us", 38.0),
        PaperValue("round_trip.least", "round trip of the quickest message", "us", 996.0),
        PaperValue("bias.least", "error of the minimum filter", "us", 19.0, less_is_better=True),
        PaperValue("messages", "messages", "", 10_000.0),
        PaperValue("left_out", "left out, over 10 ms", "", 64.0),
    ),
)
LEAST_ROUND_TRIP = PaperTable(
    "least-round-trip",
    "Least round trip of K messages",
    "section 4, and the supplement",
    (
        PaperValue("300", "of 300 messages", "us", 1870.0),
        PaperValue("1000", "of 1,000 messages", "us", 1020.0),
        PaperValue("10000", "of 10,000 messages", "us", 996.0),
    ),
)
INJECTIONS = PaperTable(
    "injections",
    "Phase alignment by injected frames, to 20 µs",
    "sections 5 and 6",
    (
        PaperValue("moves.mean", "injected frames, mean", "", 5.5, less_is_better=True, headline=True),
        PaperValue("moves.std", "injected frames, standard deviation", "", 0.97, less_is_better=True),
        PaperValue("moves.least", "fewest", "", 4.0, less_is_better=True),
        PaperValue("moves.most", "most", "", 7.0, less_is_better=True),
        PaperValue("each_s", "time for each", "s", 0.3, less_is_better=True),
        PaperValue("all_s", "time for all, largest", "s", 3.0, at_most=True, less_is_better=True),
    ),
)
RESTARTS = PaperTable(
    "restarts",
    "Phase alignment by restarts, into a window of 1 ms",
    "section 5",
    (
        PaperValue("tries.mean", "restarts, mean", "", 28.7, less_is_better=True, headline=True),
        PaperValue("tries.std", "restarts, standard deviation", "", 25.2, less_is_better=True),
        PaperValue("tries.for_95", "restarts that suffice for 95 %", "", 98.0, less_is_better=True),
        PaperValue("each_s", "time for each, mean", "s", 1.23, less_is_better=True),
        PaperValue("each_s.std", "time for each, standard deviation", "s", 0.27, less_is_better=True),
    ),
)
START_UP = PaperTable(
    "start-up",
    "Start of five phones",
    "section 4",
    (
        PaperValue(
            "five.max",
            "clocks of five phones synchronized, largest",
            "s",
            10.0,
            at_most=True,
            less_is_better=True,
            headline=True,
        ),
        PaperValue("five.mean", "clocks of five phones synchronized, mean", "s", None, less_is_better=True),
        PaperValue("one.mean", "a client's clock, mean", "s", 1.0, at_most=True, less_is_better=True),
        PaperValue("ready.mean", "clocks and phases, mean", "s", None, less_is_better=True),
    ),
)
BURST = PaperTable(
    "burst",
    "A burst of five views",
    "applications",
    (
        PaperValue("views", "views", "", 5.0),
        PaperValue("frames", "frames of each", "", 5.0),
        PaperValue("missing", "frames missing of all bursts", "", None, less_is_better=True),
        PaperValue("apart.max", "views of one instant apart, largest", "us", None, less_is_better=True),
    ),
)
FIGURE_5 = PaperFigure(
    "figure-5",
    "The LED panel, and what both phones see of it",
    "Figure 5",
    (
        PaperValue("tau", "a column is lit for", "us", 200.0),
        PaperValue("exposure", "exposure", "us", 100.0),
        PaperValue("repeats", "the panel repeats after", "ms", 20.0),
        PaperValue("apart", "these two pictures are apart", "us", None),
    ),
)
FIGURE_S2 = PaperFigure(
    "figure-s2",
    "Convergence of the filters with the number of messages",
    "Supplement, figure 2",
    (
        PaperValue("mean.10000", "mean filter, 10,000 messages", "us", 400.0, less_is_better=True),
        PaperValue("minimum.10000", "minimum filter, 10,000 messages", "us", 19.0, less_is_better=True),
        PaperValue("ours.10000", "this program, 10,000 messages", "us", None, less_is_better=True),
        PaperValue("minimum.300", "minimum filter, 300 messages", "us", None, less_is_better=True),
        PaperValue("ours.300", "this program, 300 messages", "us", None, less_is_better=True),
    ),
)

TABLES = (
    TABLE_1,
    TABLE_2,
    WORST_PAIR,
    TABLE_3,
    LEAST_ROUND_TRIP,
    INJECTIONS,
    RESTARTS,
    START_UP,
    BURST,
)
FIGURES = (FIGURE_5, FIGURE_S2)
