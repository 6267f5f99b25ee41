"""Figure 3: the exchange of one message, begun by the leader as in the paper, and by the client as here."""

import random
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.experiments.common.paper_values import FIGURE_3
from capture_app.experiments.common.plots import new_figure, save
from capture_app.experiments.common.reproduction import Measured, Reproduction
from capture_app.simulation.exchanges import TURNAROUND_NS
from capture_app.simulation.links import Channel
from capture_app.simulation.paper_link import PAPER_LINK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"leader": "tab:blue", "client": "tab:orange"}
SIDE_US = 400.0


@dataclass(frozen=True, slots=True)
class Message:
    """There and back between the one that asks and the one that answers; true times in us from the start."""

    asks: str
    times_us: tuple[float, float, float, float]
    """Sent, received, answered, and the answer received: t0 to t3."""

    @property
    def round_trip_us(self) -> float:
        """Time under way, both ways."""
        t0, t1, t2, t3 = self.times_us
        return t3 - t0 - (t2 - t1)

    @property
    def error_us(self) -> float:
        """How far the offset ((t1 - t0) + (t2 - t3)) / 2 is off: half the difference of both ways."""
        t0, t1, t2, t3 = self.times_us
        return abs((t1 - t0) - (t3 - t2)) / 2

    def figures(self) -> dict[str, float]:
        """The numbers that belong to the figure."""
        return {
            "round_trip": self.round_trip_us,
            "error": self.error_us,
            "bound": self.round_trip_us / 2,
        }


def exchange(asks: str, rng: random.Random) -> Message:
    """Send one message over the paper's link; `asks` is the leader or the client."""
    channel = Channel(PAPER_LINK)
    there_ns = min(channel.deliveries("to_client" if asks == "leader" else "to_leader", 0, rng))
    answered_ns = there_ns + TURNAROUND_NS
    back_ns = min(channel.deliveries("to_leader" if asks == "leader" else "to_client", answered_ns, rng))
    times_ns = (0, there_ns, answered_ns, answered_ns + back_ns)
    t0, t1, t2, t3 = (ns / 1000 for ns in times_ns)
    return Message(asks, (t0, t1, t2, t3))


def reproduce(seed: int) -> Reproduction:
    """Draw one message each way."""
    rng = random.Random(f"{seed} handshake")
    papers, ours = exchange("leader", rng), exchange("client", rng)
    return Reproduction(
        of=FIGURE_3,
        seed=seed,
        protocol=Measured(papers.figures(), 1, "the leader asks"),
        default=Measured(ours.figures(), 1, "the client asks"),
        simulated="Two messages on the paper's link, drawn at their true times.",
        notes=(
            "The paper's leader asks each client in turn. Here each client asks, so that any number of them "
            "can do so at once and the leader keeps nothing about them; the estimate is the same.",
        ),
        draw=lambda folder: [_draw(papers, ours, folder / "figure-3.svg")],
    )


def _draw(papers: Message, ours: Message, path: Path) -> Path:
    figure = new_figure(figsize=(10, 3.6))
    for axes, message, whose in zip(figure.subplots(1, 2), (papers, ours), ("paper", "here"), strict=True):
        _lanes(axes, message)
        axes.set_title(f"{whose}: the {message.asks} asks", loc="left")
    return save(figure, path)


def _lanes(axes: "Axes", message: Message) -> None:
    """Two lanes of time, and the message between them."""
    t0, t1, t2, t3 = message.times_us
    answers = "client" if message.asks == "leader" else "leader"
    heights = {"leader": 1.0, "client": 0.0}
    for name, height in heights.items():
        axes.axhline(height, color=COLORS[name], lw=2)
        axes.text(-SIDE_US, height, name, color=COLORS[name], ha="right", va="center", weight="bold")
    from_y, to_y = heights[message.asks], heights[answers]
    for begin, end, (low, high) in ((t0, t1, (from_y, to_y)), (t2, t3, (to_y, from_y))):
        axes.annotate(
            "", (end, high), (begin, low), arrowprops={"arrowstyle": "-|>", "lw": 1.4, "color": "0.25"}
        )
    outside = 0.1 if from_y else -0.1
    for at, height, away, name, side in (
        (t0, from_y, outside, "t0", "center"),
        (t1, to_y, -outside, "t1", "right"),
        (t2, to_y, -outside, "t2", "left"),
        (t3, from_y, outside, "t3", "center"),
    ):
        axes.plot(at, height, "o", ms=5, color="0.25")
        axes.text(at, height + away, name, ha=side, va="bottom" if away > 0 else "top")
    ways = f"{t1 - t0:.0f} µs there, {t3 - t2:.0f} µs back: the offset is {message.error_us:.0f} µs off"
    axes.text(0.5, -0.02, ways, transform=axes.transAxes, ha="center", va="top", color="0.25")
    axes.set(xlim=(-SIDE_US, t3 + SIDE_US), ylim=(-0.45, 1.45))
    axes.set_axis_off()
