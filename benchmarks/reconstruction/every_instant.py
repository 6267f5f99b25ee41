"""A cloud of every instant of a rendered take: killed on the way, begun again, and its memory watched.

    python -m benchmarks.reconstruction.every_instant --instants 60 --out DIR

Five simulated cameras (*simulated*; 640x480, or less by `--scale`) before a child that jumps. Prints how
right and how complete what moves is in the cloud of each instant, the memory of the process over time, and
what it costs beside sweeping every instant whole (`--whole`).
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from statistics import mean, median

import msgspec

from benchmarks.samples.recipe import read_recipe

WITHIN = "within_2pct", "mover_within_2pct"
RECIPE = Path(__file__).resolve().parents[2] / "sample_sessions" / "jumper"


def main() -> None:
    """Render, reconstruct with a kill in between, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--instants", type=int, default=60)
    parser.add_argument("--kill-after", type=int, default=20, help="instants that are done when it is killed")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    session = render(asked.out, asked.instants, asked.scale)
    clouds, whole, before = asked.out / "clouds", asked.out / "whole", cpu_s()
    runs = [follow(session, clouds, asked.kill_after)] if asked.kill_after else []
    runs.append(follow(session, clouds, None))
    between = cpu_s()
    runs.append(follow(session, whole, None, "--whole"))
    show(clouds, runs)
    shares = []
    for folder, cost_s in ((clouds, between - before), (whole, cpu_s() - between)):
        told = json.loads((folder / "sequence.json").read_text())["instants"]
        shares.append([[100 * one[name] for name in WITHIN] for one in told])
        right = ", movers ".join(f"{mean(share):.2f} %" for share in zip(*shares[-1], strict=True))
        print(f"{folder.name}: {cost_s / len(told):.2f} CPU-s an instant; within 2 %: {right}")
    for what, number in (("all", 0), ("movers", 1)):
        off = [mine[number] - its[number] for mine, its in zip(*shares, strict=True)]
        print(f"{what}, reused less whole: {mean(off):+.2f} points, {min(off):+.2f} to {max(off):+.2f}")


def cpu_s() -> float:
    """Processor time of all children that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def render(out: Path, instants: int, scale: float) -> Path:
    """The take, rendered once."""
    session = out / "jump"
    if not (session / "session.json").exists():
        recipe = msgspec.structs.replace(
            read_recipe(RECIPE), name="jump", frames=instants, scale=scale, take=None
        )
        out.mkdir(parents=True, exist_ok=True)
        file = out / "recipe.json"
        file.write_bytes(msgspec.json.encode(recipe))
        run = [sys.executable, "-m", "benchmarks.samples", "--out", str(out), str(file)]
        subprocess.run(run, check=True)
    return session


def follow(session: Path, clouds: Path, kill_after: int | None, *more: str) -> list[tuple[int, float]]:
    """Run the command, killed once so many instants are done; memory, MB, at each number of them."""
    command = [sys.executable, "-m", "reconstruction.cli", "multiview", str(session)]
    running = subprocess.Popen([*command, "--instants", "all", "--out", str(clouds), "--quiet", *more])
    seen: list[tuple[int, float]] = []
    while running.poll() is None:
        done = len(list((clouds / "instants").glob("*.json")))
        seen.append((done, resident_mb(running.pid)))
        if kill_after is not None and done >= kill_after:
            os.kill(running.pid, signal.SIGKILL)
        time.sleep(0.2)
    if running.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(f"the command ended with {running.returncode}")
    return seen


def resident_mb(pid: int) -> float:
    """Resident memory of a process, MB; 0 once it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, IndexError):
        return 0.0


def show(clouds: Path, runs: list[list[tuple[int, float]]]) -> None:
    """The instants, then the memory."""
    result = json.loads((clouds / "sequence.json").read_text())
    print("| instant | points | of movers | precision | recall | F at 1 cm | movers within 2 % |")
    print("|---|---|---|---|---|---|---|")
    scores = []
    for one in result["instants"]:
        found = one.get("movers_1cm")
        if not found:
            print(f"| {one['instant']} | {one['points']} | - | - | - | - | - |")
            continue
        scores.append(found["f_score"])
        right = 100 * one["mover_within_2pct"]
        print(
            f"| {one['instant']} | {one['points']} | {found['points']} | {found['precision']:.3f} "
            f"| {found['recall']:.3f} | {found['f_score']:.3f} | {right:.1f} % |"
        )
    print(f"\nF: {median(scores):.3f} in the middle, {min(scores):.3f} to {max(scores):.3f}")
    print(f"{result['clouds']} clouds, {result.get('kept', 0)} of them from before the kill")
    for seen in runs:
        peaks: dict[int, float] = {}
        for done, megabytes in seen:
            peaks[done] = max(peaks.get(done, 0.0), megabytes)
        counts = sorted(peaks)
        shown = [counts[round(k * (len(counts) - 1) / 5)] for k in range(6)] if counts else []
        print("peak MB while instant ... was made:", ", ".join(f"{k}: {peaks[k]:.0f}" for k in shown))


if __name__ == "__main__":
    main()
