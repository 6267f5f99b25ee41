"""`reconstruct multiview` on every instant of a session with truth, synchronized and offset; the medians."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.report import print_rows, talk

OFFSETS_MS = "66,-33,0,33,-66"
"""One for each of five cameras, all different: cameras that share one would agree with each other."""
SHARES = ("within_2pct", "mover_within_2pct", "static_within_2pct", "mover_coverage")

Row = dict[str, Any]


def run_session(session: Path, scratch: Path, conditions: Sequence[str]) -> list[Row]:
    """A row for each instant and condition; instants without room for the offsets have no offset row."""
    count = len(json.loads((session / "session.json").read_text())["burst"]["instants_ns"])
    rows = []
    for instant in range(count):
        for condition in conditions:
            extra = () if condition == "synced" else ("--condition", OFFSETS_MS)
            row = _one(session, instant, scratch / f"{instant}-{condition}", extra)
            if row is not None:
                rows.append({"scene": session.name, "instant": instant, "condition": condition, **row})
                talk(f"{session.name}, instant {instant}, {condition}: {row['within_2pct']:.1%} within 2 %")
    return rows


def render_longer(session: Path, instants: int, scratch: Path) -> Path:
    """Render the session's recipe again with more instants; the engine takes the burst anew."""
    recipe = json.loads((session / "recipe.json").read_text())
    recipe |= {"frames": instants, "name": f"{recipe['name']}-{instants}"}
    recipe.pop("take", None)
    (scratch / "recipe.json").write_text(json.dumps(recipe))
    command = [sys.executable, "-m", "benchmarks.samples", str(scratch / "recipe.json")]
    subprocess.run([*command, "--out", str(scratch)], check=True, stdout=sys.stderr)
    return scratch / str(recipe["name"])


def medians(rows: list[Row]) -> Row:
    """Return the medians over the instants, and the median difference of the static pixels' share."""
    found: Row = {}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        chosen = [row for row in rows if row["condition"] == condition]
        found[condition] = {"instants": len(chosen)} | {
            name: round(median(row[name] for row in chosen), 4)
            for name in (*SHARES, "worst_view", "cpu_s", "matching_s", "peak_mb")
        }
    both = {row["instant"] for row in rows if row["condition"] == "offset"}
    still = {(r["instant"], r["condition"]): r["static_within_2pct"] for r in rows if r["instant"] in both}
    if both:
        apart = [abs(still[k, "synced"] - still[k, "offset"]) for k in both if (k, "synced") in still]
        found["static_apart"] = round(median(apart), 4) if apart else None
    return found


COLUMNS = {
    "scene": ("session", ""),
    "instant": ("instant", ""),
    "condition": ("condition", ""),
    "within_2pct": ("within 2 %", ".1%"),
    "mover_within_2pct": ("movers", ".1%"),
    "static_within_2pct": ("static", ".1%"),
    "mover_coverage": ("movers covered", ".1%"),
    "worst_view": ("worst view", ".1%"),
    "cpu_s": ("cpu s", ".1f"),
    "matching_s": ("matching and fusion s", ".1f"),
    "peak_mb": ("MB", ".0f"),
}


def print_session(report: Row) -> None:
    """Print a row for each instant and condition, and the medians."""
    print_rows(report["rows"], COLUMNS)
    print(json.dumps(report["medians"], indent=2))


def _one(session: Path, instant: int, out: Path, extra: tuple[str, ...]) -> Row | None:
    command = [sys.executable, "-m", "reconstruction.cli", "multiview", str(session), "--no-mesh", "--json"]
    command += ["--matcher", "sweep", "--instant", str(instant), "--out", str(out), *extra]
    log = out.with_suffix(".log")
    with log.open("w") as errors, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors) as child:
        assert child.stdout is not None
        said = child.stdout.read()
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        if "ms from instant" in log.read_text():
            return None
        sys.exit(f"{' '.join(command)}\nended with {child.returncode}: {log.read_text()}")
    result = json.loads(said)
    main = next(view for view in result["views"] if view["camera"] == result["reference"])
    stages = result["seconds_of"]
    return {name: main[name] for name in SHARES} | {
        "camera": result["reference"],
        "worst_view": min(view["within_2pct"] for view in result["views"]),
        "cpu_s": used.ru_utime + used.ru_stime,
        "matching_s": stages["range"] + stages["matching"] + stages["fusion"],
        "peak_mb": used.ru_maxrss * 1024 / 1e6,
        "fused_points": result["fused_points"],
    }
