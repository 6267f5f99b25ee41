"""Aligns recordings of a panel drawn at random, and counts how far off they are and whether they know it.

Rendered videos, H.264, each of two cameras that see one screen (simulated).
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.panel.heard_takes import draw_lateness, record_sound
from benchmarks.panel.recorded_takes import Take, draw_take
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows, talk
from capture_app.common.errors import BadInputError
from capture_app.companions.panel.panel_alignment import match_panels
from capture_app.companions.panel.panel_track import PanelTrack
from capture_app.companions.panel.panel_video import read_panel_video
from capture_app.plugins.footage.sound import match_sounds, read_sound
from capture_app.session.format.common_times import CameraTimes


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a take: errors and 95 % error bars at its visits and between them, ms; or the refusal."""

    take: Take
    errors_ms: tuple[float, ...] = ()
    bars_ms: tuple[float, ...] = ()
    rate_error_ppm: float = 0.0
    rate_bar_ppm: float = 0.0
    read_s: float = 0.0
    refusal: str = ""


def is_seen_twice(take: Take) -> bool:
    """Return whether the cameras saw the panel again ten minutes later."""
    return len(take.cameras[0].visits_s) > 1


def is_carried(take: Take) -> bool:
    """Return whether the cameras saw the panel one after the other."""
    return take.cameras[0].visits_s != take.cameras[1].visits_s


def _on_screen(rate_hz: int) -> Callable[[Take], bool]:
    return lambda take: round(1e9 / take.panel.tick_ns) == rate_hz


def _with_a(kind: str) -> Callable[[Take], bool]:
    return lambda take: any(camera.kind == kind for camera in take.cameras)


KINDS: dict[str, Callable[[Take], bool]] = {
    "all": lambda take: True,
    "carried, seen once": lambda take: is_carried(take) and not is_seen_twice(take),
    "all others": lambda take: is_seen_twice(take) or not is_carried(take),
    **{f"a screen of {hz} Hz": _on_screen(hz) for hz in (60, 120, 144)},
    **{f"a camera {kind}": _with_a(kind) for kind in ("dim", "oblique", "blurred")},
    "a camera of 120 or 240 /s": lambda take: any(camera.rate_hz > 100 for camera in take.cameras),
    "cameras up to 30 /s": lambda take: all(camera.rate_hz < 31 for camera in take.cameras),
}
"""The rows of the table."""
COLUMNS: Columns = {
    "takes": ("takes", ""),
    "taken": ("aligned", ""),
    "refused": ("refused", ""),
    "offsets": ("offsets", ""),
    "rms_ms": ("RMSE ms", ".2f"),
    "median_ms": ("median ms", ".2f"),
    "max_ms": ("largest ms", ".2f"),
    "inside": ("inside bar", ".1%"),
    "bar_ms": ("median bar ms", ".2f"),
}


def judge(seed: int, tracks: Path | None = None) -> Outcome:
    """Record a take, align it, and compare with the truth.

    What was read is stored in the folder `tracks`, and not read again.
    """
    take = draw_take(seed)
    found: list[PanelTrack] = []
    if tracks is not None and (stored := tracks / f"{seed}.npy").exists():
        return compare(take, match_panels(*np.load(stored, allow_pickle=True)))
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{number}.mp4" for number in range(2)]
        for camera, path in zip(take.cameras, paths, strict=True):
            camera.record(path)
        began = time.process_time()
        for path in paths:
            try:
                found.append(read_panel_video(path))
            except BadInputError as error:
                return Outcome(take, refusal=error.what)
    read_s = time.process_time() - began
    if tracks is not None:
        np.save(tracks / f"{seed}.npy", np.array(found, object), allow_pickle=True)
    return compare(take, match_panels(*found), read_s)


def hear(seed: int, *, one_model: bool = False) -> Outcome:
    """Align a take by claps that its microphones heard at the visits, and compare with the truth."""
    take = draw_take(seed)
    late_s, error_s = draw_lateness(seed, one_model=one_model)
    rng = np.random.default_rng([seed, 13])
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{number}.mp4" for number in range(2)]
        for camera, path, late in zip(take.cameras, paths, late_s, strict=True):
            # A clap is heard by both at once, where a panel is carried from one to the other.
            there = replace(camera, visits_s=take.cameras[1].visits_s)
            record_sound(there, path, late, rng)
        began = time.process_time()
        heard, other = (read_sound(path) for path in paths)
        return compare(take, match_sounds(heard, other, error_s), time.process_time() - began)


def compare(take: Take, times: CameraTimes, read_s: float = 0.0) -> Outcome:
    """Compare an alignment with the truth, at each visit's middle and midway between two."""
    if times.offset_ns is None:
        return Outcome(take, refusal=times.reason)
    reference, camera = take.cameras
    moments = [at + 0.5 for at in camera.visits_s]
    errors, bars = [], []
    for true_s in [*moments, *([sum(moments) / 2] if len(moments) > 1 else [])]:
        own_ns = round(camera.own_s(true_s) * 1e9)
        errors.append(times.leader_from_local(own_ns) / 1e6 - reference.own_s(true_s) * 1e3)
        bars.append((times.uncertainty_at_ns(own_ns) or 0) / 1e6)
    true_ppm = reference.ppm - camera.ppm
    return Outcome(
        take,
        tuple(errors),
        tuple(bars),
        times.rate_ppm - true_ppm,
        times.rate_uncertainty_ppm or 0.0,
        read_s,
    )


def tally(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return takes, refusals, RMSE, largest error, coverage and median bar, of all takes and of kinds."""
    rows: list[dict[str, Any]] = []
    for name, is_one in KINDS.items():
        some = [o for o in outcomes if is_one(o.take)]
        read = [o for o in some if not o.refusal]
        if not read:
            continue
        errors = np.abs(np.concatenate([o.errors_ms for o in read]))
        bars = np.concatenate([o.bars_ms for o in read])
        rows.append(
            {
                "takes": name,
                "taken": len(read),
                "refused": len(some) - len(read),
                "offsets": len(errors),
                "rms_ms": float(np.sqrt((errors**2).mean())),
                "median_ms": float(np.median(errors)),
                "max_ms": float(errors.max()),
                "inside": float((errors <= bars).mean()),
                "bar_ms": float(np.median(bars)),
            }
        )
    return rows


def measure(seeds: range, jobs: int, align: Callable[[int], Outcome]) -> Report:
    """Align the takes of these seeds, and print each on stderr."""
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for seed, one in zip(seeds, pool.map(align, seeds), strict=True):
            outcomes.append(one)
            rates = " and ".join(f"{c.rate_hz:.4g} Hz {c.kind}" for c in one.take.cameras)
            found = zip(one.errors_ms, one.bars_ms, strict=True)
            says = one.refusal or " ".join(f"{error:+.2f}±{bar:.2f}" for error, bar in found)
            talk(f"{seed:4d} {one.take.panel.name:18s} {rates}: {says}")
    rates_of = [o for o in outcomes if not o.refusal and is_seen_twice(o.take)]
    return {
        "kind": "simulated",
        "takes": len(seeds),
        "first": seeds.start,
        "offsets": tally(outcomes),
        "rates_rms_ppm": float(np.sqrt(np.mean([o.rate_error_ppm**2 for o in rates_of])))
        if rates_of
        else None,
        "rates_inside": sum(abs(o.rate_error_ppm) <= o.rate_bar_ppm for o in rates_of),
        "rates": len(rates_of),
        "read_s": float(np.median([o.read_s for o in outcomes if o.read_s] or [0.0])),
    }


def print_tables(report: Report) -> None:
    """Print the offsets of all kinds of takes, and the rates."""
    print_rows(report["offsets"], COLUMNS)
    if report["rates"]:
        inside = f"{report['rates_inside']} of {report['rates']}"
        print(f"rates, seen twice: RMSE {report['rates_rms_ppm']:.2f} ppm, {inside} inside the bar")
    print(f"reading takes {report['read_s']:.0f} s of a processor (median, two videos)")


def main() -> None:
    """Run it and print the table."""
    parser = new_parser(__doc__)
    parser.add_argument("--count", type=int, default=40, help="number of takes (40)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first take (0)")
    parser.add_argument("--jobs", type=int, default=1, help="takes at a time (1)")
    parser.add_argument("--tracks", type=Path, help="folder for what was read; what is there is used")
    parser.add_argument("--by", choices=("panel", "sound", "sound-of-one-model"), default="panel")
    options = parser.parse_args()
    align = partial(judge, tracks=options.tracks)
    if options.by != "panel":
        align = partial(hear, one_model=options.by == "sound-of-one-model")
    seeds = range(options.first, options.first + options.count)
    print_report(measure(seeds, options.jobs, align), print_tables, as_json=options.json)


if __name__ == "__main__":
    main()
