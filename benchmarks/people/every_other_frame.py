"""Joints of a real film of which one camera is reduced to every other frame, half a frame off. Real footage.

Each camera in turn keeps its odd frames alone, and people are located at the even ones: interpolated by each
frame's own time, and by the nearest frames as other programs pair them. A distance is that from the joints
which all frames give.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.people.figure import Floats
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from capture_app.console.terminal import Progress
from reconstruction.methods.people.keypoints import detect_people
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder, camera_frames
from reconstruction.scene.scene import Scene

COLUMNS: Columns = {
    "camera": ("reduced camera", ""),
    "by": ("by", ""),
    "median": ("median", ".4f"),
    "most": ("90 %", ".4f"),
    "fast": ("fastest tenth, median", ".4f"),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the distances for each camera of a session, in the calibration's unit."""
    parser = new_parser(__doc__)
    parser.add_argument("session", type=Path, help="calibrated, of one person, cameras in step")
    parser.add_argument("--cameras", type=int, help="the first so many cameras (all)")
    options = parser.parse_args(arguments)
    scene = Scene.open(options.session)
    names = list(scene.views)[: options.cameras]
    progress = Progress(len(names), silent=True)
    keypoints = detect_people(scene.dataset, names, "blazepose", "full", progress)
    whole = {name: camera_frames(scene.dataset, scene.views, keypoints)[name] for name in names}
    period_s = scene.dataset.period_ns / 1e9
    times_s = whole[names[0]].frame_s[4:-4:2]

    def located(frames: dict[str, CameraFrames], *, nearest: bool = False) -> Floats:
        finder = PeopleFinder(frames, keypoints.skeleton, period_s)
        return finder.at(times_s, nearest=nearest).people[0].positions

    truth = located(whole)
    speeds = np.full(truth.shape[:2], np.nan)
    speeds[1:-1] = np.linalg.norm(truth[2:] - truth[:-2], axis=2)
    rows = list[dict[str, object]]()
    for name in names:
        kept = {k: joints for k, joints in whole[name].joints.items() if k % 2}
        frame_s = np.where(np.arange(len(whole[name].frame_s)) % 2, whole[name].frame_s, np.nan)
        reduced = {**whole, name: whole[name]._replace(frame_s=frame_s, joints=kept)}
        for by in ("time", "nearest"):
            apart = np.linalg.norm(located(reduced, nearest=by == "nearest") - truth, axis=2)
            fast = apart[speeds > np.nanpercentile(speeds, 90)]
            known = apart[np.isfinite(apart)]
            rows.append({
                "camera": name,
                "by": by,
                "median": float(np.median(known)),
                "most": float(np.percentile(known, 90)),
                "fast": float(np.nanmedian(fast)),
            })  # fmt: skip
    report: Report = {"kind": "real footage", "cameras": len(names), "unit": scene.unit, "rows": rows}
    print_report(report, lambda of: print_rows(of["rows"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
