"""Jobs of an earlier run and what they found, on disk."""

import json
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from capture_app.session.library.changes import results_folder
from capture_app.tui.jobs.run import COMMANDS, Run, RunState

TOLERANCE_VERDICT = "This motion tolerates a delay of about 3.9 ms."
PANEL_VERDICT = "32 µs apart on average, 121 µs at most; the panel resolves ±14 µs"
VERDICT = (
    "When both pictures show the same instant, the right distance is found for 97 % of what moves; with one "
    "picture 67 ms late, for 2 %. What stands still is found equally well both times."
)
ENDED = datetime(2026, 1, 31, 12, 0, tzinfo=UTC)


def add_job(root: Path, name: str, session: str, state: RunState = RunState.DONE, message: str = "") -> Run:
    """Keep a run of an earlier start of the screen."""
    command = COMMANDS[name]
    folder = results_folder(root / session, root)
    out = folder / name if command.writes else None
    about = {
        "kind": name,
        "session": session,
        "out": str(out.relative_to(root)) if out else "",
        "options": command.quick,
        "state": state,
        "message": message,
        "ended": ENDED.isoformat(),
        "seconds": 83.0,
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(about))
    (folder / f"{name}.log").write_text(
        "[1/9] calibration\n[2/9] stereo cam00-cam01, instant 1\n[9/9] report\n"
    )
    return Run(kind=name, session=root / session, out=out, state=state, message=message)


def picture(path: Path, level: int) -> None:
    """A picture of one grey level with a bright square."""
    pixels = np.full((96, 128, 3), level, np.uint8)
    pixels[32:64, 48:80] = 255
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), pixels)


def pair(key: str, title: str, folder: Path, *, form: str = "png") -> dict[str, object]:
    paths = {side: f"pictures/{key}_{side}.{form}" for side in ("synced", "offset")}
    picture(folder / paths["synced"], 60)
    picture(folder / paths["offset"], 140)
    return {"key": key, "title": title, "caption": "Bright is near, blue is far.", **paths}


def study(name: str, *pictures: dict[str, object], skipped: str = "") -> dict[str, object]:
    cameras = [] if skipped else ["cam00", "cam01"]
    return {"name": name, "cameras": cameras, "skipped": skipped, "pictures": list(pictures)}


def add_comparison(root: Path, session: str) -> Run:
    """A finished comparison with depth of a pair, a panorama and a table."""
    job = add_job(root, "compare", session, message=VERDICT)
    assert job.out is not None
    table = {
        "caption": "Depth from cameras cam00 and cam01",
        "groups": ["Moving things", "Moving things", "Things at rest (control)", "Things at rest (control)"],
        "columns": ["Synced", "67 ms late", "Synced", "67 ms late"],
        "rows": [
            ["Measured correctly", "96.8 %", "1.6 %", "86.0 %", "86.0 %"],
            ["Given a distance", "98.0 %", "21.9 %", "96.8 %", "96.9 %"],
        ],
    }
    found = {
        "verdict": VERDICT,
        "studies": [
            study("multiview", skipped="it was not requested"),
            study(
                "stereo",
                pair("stereo_late", "Late", job.out),
                pair("stereo_depth", "Distance", job.out),
            ),
            study("panorama", pair("panorama", "Panorama", job.out, form="jpg")),
        ],
        "words": {
            "synced": "Synchronized",
            "offset": "67 ms late",
            "unsynchronized": "unsynchronized",
            "tables": [table],
        },
        "report": "report.html",
    }
    (job.out / "report.html").write_text("<h1>report</h1>")
    (job.out / "metrics.json").write_text(json.dumps(found))
    return job


def add_panorama(root: Path, session: str) -> Run:
    """A panorama in both conditions."""
    job = add_job(root, "panorama", session)
    assert job.out is not None

    def side(name: str, misfit: float) -> dict[str, object]:
        for what in ("panorama", "ghosts"):
            picture(job.out / f"{what}_{name}.jpg", 90)
        moving = {"points": 80, "lost": 3, "median_px": misfit, "p95_px": 2 * misfit}
        known = {"misfit": {**moving, "median_px": 0.3}, "mover_misfit": moving}
        overlap = {"first": "cam00", "second": "cam01", **known, "mad": 3.0}
        paths = {what: f"{what}_{name}.jpg" for what in ("panorama", "ghosts")}
        return {**paths, **known, "overlaps": [overlap]}

    found = {
        "used": ["cam00", "cam01"],
        "left_out": {"cam02": "it shows nothing that the others show"},
        "synced": side("synced", 1.7),
        "offset": side("offset", 11.8),
        "actual_offset_ms": 66.7,
    }
    (job.out / "metrics.json").write_text(json.dumps(found))
    return job


def add_dose(root: Path, session: str) -> Run:
    """A curve of three points."""
    job = add_job(root, "tolerance", session)
    assert job.out is not None
    job.out.mkdir(parents=True)
    points = [
        {
            "offsets_ms": {"cam00": 0.0, "cam01": ms},
            "measures": [
                {"name": "mover_coverage", "offset": None if fraction is None else {"value": fraction}},
                {"name": "static_coverage", "offset": {"value": 0.9}},
            ],
        }
        for ms, fraction in ((0.0, 0.97), (33.3, 0.2), (66.7, None))
    ]
    found = {
        "measure": "mover_coverage",
        "cameras": ["cam00", "cam01"],
        "points": points,
        "verdict": TOLERANCE_VERDICT,
        "tolerable_offset_ms": 3.87,
        "report": "report.html",
    }
    (job.out / "metrics.json").write_text(json.dumps(found))
    return job


def add_depth(root: Path, session: str) -> Run:
    """Depth maps of two cameras."""
    job = add_job(root, "multiview", session)
    assert job.out is not None
    views = []
    for camera in ("cam00", "cam01"):
        picture(job.out / f"{camera}.png", 100)
        views.append({"camera": camera, "coverage": 0.93, "within_2pct": None, "picture": f"{camera}.png"})
    found = {
        "views": views,
        "reference": "cam00",
        "within_2pct": None,
        "fused_points": 46166,
        "left_out": {},
        "nearest": 1.2,
        "farthest": 7.0,
        "unit": "m",
        "files": ["fused.ply", "depth.npz"],
    }
    (job.out / "multiview.json").write_text(json.dumps(found))
    return job


def add_clouds(root: Path, session: str) -> Run:
    """Clouds of two instants, of which one failed."""
    job = add_job(root, "clouds", session)
    assert job.out is not None
    job.out.mkdir(parents=True)
    found = {
        "clouds": 1,
        "mover_f_score_1cm": 0.878,
        "instants": [
            {"instant": 0, "cloud": "clouds/000000.ply", "points": 28650, "mover_within_2pct": 0.98},
            {"instant": 1, "reason": "no camera has a picture"},
        ],
        "files": ["clouds", "instants", "movers", "plan.json", "sequence.json"],
    }
    (job.out / "sequence.json").write_text(json.dumps(found))
    return job


def add_panel(root: Path, session: str, *, compared: bool = True) -> Run:
    """What a panel showed of two cameras; `compared`: of one instant at least, in both."""
    job = add_job(root, "panel", session)
    assert job.out is not None
    job.out.mkdir(parents=True)
    seen = {
        "caption": "led-pair in the pictures",
        "groups": [""] * 5,
        "columns": ["read", "refused", "95 % error", "exposure", "row time"],
        "rows": [
            ["cam00", "5", "0", "±10 µs", "500 µs", "15 µs"],
            ["cam01", "5", "1", "±10 µs", "500 µs", "0 ns"],
        ],
    }
    apart = {
        "caption": "led-pair: how far apart (phase: by the stamps; clock: the rest)",
        "groups": [""] * 6,
        "columns": ["error", "mean abs", "std", "largest", "mean", "instants"],
        "rows": [
            ["cam00 - cam01", "total", "32 µs", "5.0 µs", "121 µs", "-2.0 µs", "5"],
            ["", "phase", "7.0 µs", "5.0 µs", "21 µs", "-2.0 µs", ""],
            ["", "clock", "30 µs", "5.0 µs", "115 µs", "-2.0 µs", ""],
        ],
    }
    words = {
        "verdict": PANEL_VERDICT if compared else "no instant has two pictures that could be read",
        "tables": [apart, seen] if compared else [seen],
        "remarks": ["panel led-pair: a tick of 200 µs, the same again after 1.0 s"],
    }
    (job.out / "panel.json").write_text(json.dumps({"panel": "led-pair", "words": words}))
    return job
