"""How wrong alignment by sound and by flashes is, and how often its error bar holds: rendered recordings.

Pairs of videos with unknown starts, one at 29.97 frames a second, clocks off by 20 ppm (sd), every other one
with irregular frames: python -m benchmarks.sessions.alignment --trials 30
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from capture_app.session.alignment.flashes import match_flashes, read_lights
from capture_app.session.alignment.tracks import match_sounds, read_sound
from capture_app.session.format.common_times import CameraTimes
from tests.session.alignment.cut_apart import Phone, Take

SECONDS = 16.0
EVENTS = 10


def main() -> None:
    """Print each method's errors and the share of trials within the error bar."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=10)
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    for method in ("sound", "flash"):
        found = [one for k in range(chosen.trials) if (one := _try(method, chosen.seed + k)) is not None]
        if not found:
            print(f"{method}: none of {chosen.trials} trials was aligned")
            continue
        errors, bars = np.abs(np.array(found)).T
        held = (errors <= bars).sum()
        print(
            f"{method}: {len(found)} of {chosen.trials} aligned, {held} within the bar; error in ms "
            f"{np.median(errors):.3f} at the median, {errors.max():.3f} at most; bar {np.median(bars):.2f}"
        )


def _try(method: str, seed: int) -> tuple[float, float] | None:
    """Error and error bar of a trial, ms; None where it was not aligned."""
    rng = np.random.default_rng(seed)
    apart = (SECONDS - 7) / EVENTS
    events = tuple(3.5 + apart * (np.arange(EVENTS) + 0.8 * rng.uniform(0, 1, EVENTS)))
    take = Take(claps_s=events[::2], seed=seed) if method == "sound" else Take(flashes_s=events, seed=seed)
    readouts, exposures = rng.uniform(0.010, 0.030, 2), rng.uniform(0.002, 0.015, 2)
    kinds = (("a", 0.0, 30), ("b", rng.uniform(-3, 3), 30_000 / 1001))
    first, second = (
        Phone(
            name,
            start_s=start_s,
            fps=fps,
            ppm=rng.normal(0, 20),
            jitter_s=0.01 * (seed % 2) * number,
            readout_s=readouts[number],
            exposure_s=exposures[number],
            seed=2 * seed + number,
        )
        for number, (name, start_s, fps) in enumerate(kinds)
    )
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{phone.name}.mp4" for phone in (first, second)]
        for phone, path in zip((first, second), paths, strict=True):
            phone.record(take, path, SECONDS, sound=method == "sound")
        times = _measure(method, *paths)
    if times.offset_ns is None or times.uncertainty_ns is None:
        return None
    at_ns = times.epoch_local_ns
    true_s = float(first.own_s(second.true_s(at_ns / 1e9)))
    return times.leader_from_local(at_ns) / 1e6 - true_s * 1e3, times.uncertainty_ns / 1e6


def _measure(method: str, first: Path, second: Path) -> CameraTimes:
    if method == "sound":
        sounds = read_sound(first), read_sound(second)
        if isinstance(sounds[0], str) or isinstance(sounds[1], str):
            return CameraTimes()
        return match_sounds(sounds[0], sounds[1], 0.0)
    lights = read_lights(first), read_lights(second)
    if isinstance(lights[0], str) or isinstance(lights[1], str):
        return CameraTimes()
    return match_flashes(lights[0], lights[1])


if __name__ == "__main__":
    main()
