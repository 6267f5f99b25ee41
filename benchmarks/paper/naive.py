"""Triggers sent to cameras that are not synchronized, by their known mechanisms, beside the whole chain."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.paper.panel_trial import run_trial
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.result import Outcome, Result, Table, error_figures, new_figure, save
from benchmarks.paper.trials import call_all, share_of
from benchmarks.paper.values import TABLE_1, TABLE_2
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.console.terminal import talk

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
    return rng.uniform(0.0, BEACON_MS) + PAPER_LINK.open().deliveries("to_client", 0, rng)[0] / 1e6


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


TRIALS = 1000
CHAIN_SHARE = 0.005
"""Share of the trials that the whole chain gets: it takes a second each, the others none."""
CHAIN_LEAST = 3
FIGURES = {"mean_abs": "mean", "max": "max", "std": "std"}
"""Ours and the paper's names."""
NOTES = (
    "Modelled from mechanisms that have published numbers, none of them the paper's table: input polling, "
    "Bluetooth connection intervals, WiFi power saving, the frame grid. What the paper's phones have beyond "
    "that, their camera apps added.",
    "Failed triggers (the paper: 2 of 20 wired, 1 of 20 by Bluetooth) have no such mechanism and are not "
    "modelled.",
    "Ours is the whole chain of `led-panel`, in fewer trials.",
)


def draw_sizes(seed: str, count: int) -> dict[str, list[float]]:
    """How far apart pictures are, in ms, by trigger."""
    sizes: dict[str, list[float]] = {}
    for name, trigger in TRIGGERS.items():
        rng = random.Random(f"{seed}/{name}")
        sizes[name] = [trigger.apart_ms(rng) for _ in range(count)]
    return sizes


def run(*, trials: int | None, seed: int, least_chain_trials: int = CHAIN_LEAST) -> Outcome:
    """Run it: the modelled triggers, and our chain read off pictures of the LED panel."""
    count = TRIALS if trials is None else trials
    sizes_ms = draw_sizes(str(seed), count)
    chain = max(least_chain_trials, round(CHAIN_SHARE * count))
    talk("our chain ...")
    done = call_all([partial(run_trial, random.Random(f"{seed}/{n}")) for n in range(chain)])
    chain_us = [trial.decoded_us for trial in done]
    result = Result(
        name="naive",
        kind="simulated",
        seed=seed,
        trials=count,
        ours={"total_us": error_figures(chain_us), "chain_trials": chain},
        baseline={f"{name}_ms": figures_of(sizes) for name, sizes in sizes_ms.items()},
        paper={
            f"{name}_ms": {ours: TABLE_1[f"{name}.{theirs}"] for ours, theirs in FIGURES.items()}
            | ({"failed_of_20": TABLE_1[f"{name}.failed"]} if name != "wifi" else {})
            for name in TRIGGERS
            if name != "usb"
        },
    )
    return Outcome(result, (_table(result),), NOTES, lambda folder: [_draw(sizes_ms, folder / "naive.png")])


def figures_of(sizes_ms: list[float]) -> dict[str, float]:
    """Mean, largest and deviation of distances in ms."""
    figures = error_figures(sizes_ms)
    return {key: figures[key] for key in FIGURES}


def _table(result: Result) -> Table:
    rows = []
    for name, trigger in TRIGGERS.items():
        paper = result.paper.get(f"{name}_ms")
        rows.append(
            (
                trigger.title,
                trigger.mechanisms,
                *(f"{result.baseline[f'{name}_ms'][key]:.0f} ms" for key in FIGURES),
                *(f"{paper[key]:.0f} ms" if paper else "-" for key in FIGURES),
                f"{paper['failed_of_20']:.0f} of 20" if paper and "failed_of_20" in paper else "-",
            )
        )
    ours = result.ours["total_us"]
    chain = tuple(f"{ours[key] / 1000:.3f} ms" for key in FIGURES)
    theirs = tuple(f"{TABLE_2[f'total.{key}'] / 1000:.3f} ms" for key in FIGURES.values())
    rows.append(("our chain, simulated", "clock and phase", *chain, *theirs, "-"))
    head = ("way", "mechanisms", "mean", "largest", "std", "paper: mean", "largest", "std", "failed")
    return Table(head, rows, "How far apart two cameras' pictures are")


def _draw(sizes_ms: Mapping[str, list[float]], path: Path) -> Path:
    figure = new_figure(figsize=(15, 4))
    for axes, (name, sizes) in zip(figure.subplots(1, len(sizes_ms)), sizes_ms.items(), strict=True):
        axes.hist(sizes, bins=30)
        if name != "usb":
            mean_ms = TABLE_1[f"{name}.mean"]
            axes.axvline(mean_ms, color="tab:red", linestyle="--", label="paper: mean")
            axes.legend(fontsize="small")
        axes.set(title=TRIGGERS[name].title, xlabel="distance, ms", ylabel="trials", xlim=(0, None))
    return save(figure, path)


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Set what known mechanisms explain beside what the paper measured."""
    count = share_of(TRIALS, share, least=200)
    talk(f"{count} triggers of each kind")
    sizes_ms = {name: sizes for name, sizes in draw_sizes(str(seed), count).items() if name != "usb"}
    values = {
        f"{name}.{theirs}": figures_of(sizes)[ours]
        for name, sizes in sizes_ms.items()
        for ours, theirs in FIGURES.items()
    }
    return [
        Reproduction(
            of=TABLE_1,
            protocol=Measured(values, count, "only mechanisms with published numbers"),
            default=None,
            simulated="Everything: no phone was triggered. The paper's figures stand as it gives them.",
            notes=NOTES[:2],
        )
    ]
