"""Figures 3 and 4: what the paper draws by hand, drawn from simulated messages and frames."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import new_figure, save
from benchmarks.paper.values import FIGURE_3, FIGURE_4
from benchmarks.simulated.aligner_bench import Bench
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.simulation.exchanges import TURNAROUND_NS
from capture_app.simulation.profiles import PROFILES
from capture_app.simulation.sensor import Sensor, SensorFrame

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
    channel = PAPER_LINK.open()
    there_ns = min(channel.deliveries("to_client" if asks == "leader" else "to_leader", 0, rng))
    answered_ns = there_ns + TURNAROUND_NS
    back_ns = min(channel.deliveries("to_leader" if asks == "leader" else "to_client", answered_ns, rng))
    times_ns = (0, there_ns, answered_ns, answered_ns + back_ns)
    t0, t1, t2, t3 = (ns / 1000 for ns in times_ns)
    return Message(asks, (t0, t1, t2, t3))


def figure_3(seed: int) -> Reproduction:
    """Draw one message each way."""
    rng = random.Random(f"{seed} handshake")
    papers, ours = exchange("leader", rng), exchange("client", rng)
    return Reproduction(
        of=FIGURE_3,
        protocol=Measured(papers.figures(), 1, "the leader asks"),
        default=Measured(ours.figures(), 1, "the client asks"),
        simulated="Two messages on the paper's link, drawn at their true times.",
        notes=(
            "Here each client asks, so that any number of them can do so at once and the leader keeps "
            "nothing about them.",
        ),
        draw=partial(_draw_exchanges, papers, ours),
        suffix=".svg",
    )


def _draw_exchanges(papers: Message, ours: Message, path: Path) -> Path:
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


WINDOW_NS = 1_000_000
"""The paper's epsilon, in all: half of it to each side of the goal."""
TOLERANCE_NS = 20_000
SLEEP_NS = 1_000_000_000
MOST_RESTARTS = 1000
SEARCH_NS = 120_000_000_000
BEFORE, AFTER = 2, 3
"""Frames that are drawn before and after the injected one."""
RESTARTED = replace(PROFILES["webcam"], start_latency_ns=(700_000_000, 58_000_000))
"""Starts in 600 to 800 ms (paper, section 5.1)."""
INJECTED = PROFILES["perfect"]
"""An injected exposure of T + delta shifts this one by delta."""
BLUE, ORANGE, GREEN, GREY = "tab:blue", "tab:orange", "tab:green", "0.6"


@dataclass(frozen=True, slots=True)
class Injected:
    """Frames of a stream around an injected one; the goal's instants are multiples of the period."""

    frames: tuple[SensorFrame, ...]
    ends_ns: tuple[int, ...]
    """When the next frame begins."""
    delta_ns: int
    left_ns: int


@dataclass(frozen=True, slots=True)
class Aligned:
    """Phase errors in ns of a camera that the engine aligned, after each of its moves."""

    errors_ns: tuple[int, ...]

    @property
    def moves(self) -> int:
        """How many it took."""
        return len(self.errors_ns) - 1


def restart_until_inside(rng: random.Random) -> list[int]:
    """Phase errors in ns of a camera that is restarted after a random sleep until one is in the window."""
    sensor, period_ns = Sensor(RESTARTED, rng), RESTARTED.period_ns
    errors_ns: list[int] = []
    now_ns = 0
    while len(errors_ns) <= MOST_RESTARTS:
        sensor.restart(now_ns + round(rng.random() * SLEEP_NS))
        frame = sensor.next_frame()
        now_ns = frame.readout_end_true_ns
        errors_ns.append((frame.start_true_ns + period_ns // 2) % period_ns - period_ns // 2)
        if abs(errors_ns[-1]) <= WINDOW_NS / 2:
            break
    return errors_ns


def inject_once(rng: random.Random) -> Injected:
    """Inject one frame of exposure T + delta, and see the stream on the goal."""
    sensor, period_ns = Sensor(INJECTED, rng, period_error_ppm=0.0), INJECTED.period_ns
    sensor.restart(round(rng.uniform(0.3, 0.8) * period_ns))
    frames = [sensor.next_frame()]
    delta_ns = -frames[0].start_true_ns % period_ns
    sensor.inject(period_ns + delta_ns, frames[0].start_true_ns)
    while frames[-1].exposure_ns <= period_ns:
        frames.append(sensor.next_frame())
    at = len(frames) - 1
    frames += [sensor.next_frame() for _ in range(AFTER + 1)]
    left_ns = (frames[-1].start_true_ns + period_ns // 2) % period_ns - period_ns // 2
    shown = frames[at - BEFORE : -1]
    ends_ns = tuple(frame.start_true_ns for frame in frames[at - BEFORE + 1 :])
    return Injected(tuple(shown), ends_ns, delta_ns, left_ns)


def align(profile: str, tolerance_ns: int, seed: int) -> Aligned:
    """Let the engine bring one camera of that model into phase."""
    bench = Bench(PROFILES[profile], seed, tolerance_ns, ppm=10.0)
    errors_ns: list[int] = []
    moves = last_ns = 0
    look = bench.deliver()
    while look is None or (not look.aligned and bench.now_ns < SEARCH_NS):
        if len(bench.commands) > moves:
            errors_ns.append(last_ns)
            moves = len(bench.commands)
        if look is not None:
            last_ns = look.error_ns
        look = bench.deliver()
    return Aligned((*errors_ns, look.error_ns))


def figure_4(seed: int) -> Reproduction:
    """Draw the paper's three panels, and what the engine does in their place."""
    restarts = restart_until_inside(random.Random(f"{seed} restarts"))
    injected = inject_once(random.Random(f"{seed} injected"))
    aimed, learned = align("webcam", WINDOW_NS // 2, seed), align("phone-a", TOLERANCE_NS, seed)
    papers = {
        "restarts": float(len(restarts) - 1),
        "left": abs(restarts[-1]) / 1000,
        "injections": 1.0,
        "left_injected": abs(injected.left_ns) / 1000,
    }
    ours = {
        "restarts": float(aimed.moves),
        "left": abs(aimed.errors_ns[-1]) / 1000,
        "injections": float(learned.moves),
        "left_injected": abs(learned.errors_ns[-1]) / 1000,
    }
    return Reproduction(
        of=FIGURE_4,
        protocol=Measured(papers, 1, "a random sleep before each restart; an ideal sensor"),
        default=Measured(
            ours, 1, "a webcam's aimed restarts into the same window; a phone that nobody has seen, to 20 us"
        ),
        simulated="Frames of simulated sensors at their true times; clocks are known exactly.",
        notes=("One camera each, for the drawing; how many it takes on average is in the tables.",),
        draw=partial(_draw_phases, restarts, injected, aimed, learned),
        suffix=".svg",
    )


def _draw_phases(
    restarts: list[int], injected: Injected, aimed: Aligned, learned: Aligned, path: Path
) -> Path:
    figure = new_figure(figsize=(11, 8.5))
    panels = figure.subplot_mosaic(
        [list("aa"), list("bd"), list("cc"), list("ee")], height_ratios=[1, 1.6, 1, 1.3]
    )
    _offset(panels["a"], injected)
    _phases(panels["b"], restarts, "(b) restarts, as in the paper")
    _phases(panels["d"], list(aimed.errors_ns), "ours: restarts are aimed", shares=panels["b"])
    _injection(panels["c"], injected)
    _injections(panels["e"], learned)
    return save(figure, path)


def _frames(axes: "Axes", injected: Injected, count: int) -> None:
    """Frames as bars, exposures dark in them, with the goal's instants dashed."""
    zero_ns, period_ns = _zero_ns(injected), INJECTED.period_ns
    for frame, end_ns in list(zip(injected.frames, injected.ends_ns, strict=True))[:count]:
        begin = (frame.start_true_ns - zero_ns) / 1e6
        long = frame.exposure_ns > period_ns
        axes.barh(0, (end_ns - frame.start_true_ns) / 1e6, 0.6, begin, color="0.9", edgecolor="0.4")
        axes.barh(0, frame.exposure_ns / 1e6, 0.6, begin, color=ORANGE if long else BLUE)
    last_ms = (injected.ends_ns[count - 1] - zero_ns) / 1e6
    for at in range(int(last_ms / (period_ns / 1e6)) + 2):
        axes.axvline(at * period_ns / 1e6, color=GREEN, ls="--", lw=1.5)
    axes.set(yticks=[], ylim=(-0.5, 1.0), xlabel="ms", xlim=(0, last_ms + 12))


def _zero_ns(injected: Injected) -> int:
    """An instant of the goal just before the first frame."""
    first_ns = injected.frames[0].start_true_ns
    return first_ns - first_ns % INJECTED.period_ns


def _arrow(axes: "Axes", begin: float, end: float, text: str) -> None:
    axes.annotate("", (end, 0.5), (begin, 0.5), arrowprops={"arrowstyle": "<->", "lw": 1.3})
    plain = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    axes.text((begin + end) / 2, 0.55, text, ha="center", va="bottom", bbox=plain)


def _offset(axes: "Axes", injected: Injected) -> None:
    _frames(axes, injected, BEFORE)
    begin = (injected.frames[0].start_true_ns - _zero_ns(injected)) / 1e6
    _arrow(axes, begin, begin + injected.delta_ns / 1e6, f"{injected.delta_ns / 1e6:.1f} ms to the goal")
    axes.set_title("(a) frames of a stream, and the goal's instants (dashed)", loc="left")


def _injection(axes: "Axes", injected: Injected) -> None:
    _frames(axes, injected, len(injected.frames))
    long = injected.frames[BEFORE]
    begin = (long.start_true_ns - _zero_ns(injected)) / 1e6
    _arrow(axes, begin, begin + long.exposure_ns / 1e6, f"exposed T + {injected.delta_ns / 1e6:.1f} ms")
    left = f"{abs(injected.left_ns) / 1000:.0f} µs"
    axes.set_title(f"(c) one frame of exposure T + delta, as in the paper: {left} are left", loc="left")


def _phases(axes: "Axes", errors_ns: list[int], title: str, *, shares: "Axes | None" = None) -> None:
    """Phase after each restart, with the window."""
    from matplotlib.ticker import MaxNLocator

    if shares is not None:
        axes.sharex(shares)
    half_ms, tries = WINDOW_NS / 2e6, range(len(errors_ns))
    axes.axvspan(-half_ms, half_ms, color=GREEN, alpha=0.35, lw=0)
    colors = [GREY] * (len(errors_ns) - 1) + [GREEN]
    axes.scatter([ns / 1e6 for ns in errors_ns], tries, c=colors, s=26, zorder=3)
    axes.set_title(f"{title}: {len(errors_ns) - 1}", loc="left")
    axes.set(xlabel="phase error, ms", ylabel="restart")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.invert_yaxis()


def _injections(axes: "Axes", learned: Aligned) -> None:
    """Phase error after each injection, to scale of its size."""
    errors_us = [abs(ns) / 1000 for ns in learned.errors_ns]
    axes.axhspan(0.5, TOLERANCE_NS / 1000, color=GREEN, alpha=0.35, lw=0)
    axes.plot(range(len(errors_us)), [max(us, 0.6) for us in errors_us], "o-", color=ORANGE)
    for at, us in enumerate(errors_us):
        axes.annotate(f"{us:.0f} µs", (at, max(us, 0.6)), (6, 6), textcoords="offset points")
    axes.set(yscale="log", ylim=(0.5, 60_000), xlabel="injected frames", ylabel="phase error, µs")
    axes.set(xticks=range(len(errors_us)), xlim=(-0.2, len(errors_us) - 0.4))
    axes.set_title("ours: the engine learns a phone that nobody has seen", loc="left")


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Draw both; each shows single messages and cameras, whatever the share."""
    return [figure_3(seed), figure_4(seed)]
