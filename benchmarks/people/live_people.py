"""Live people: joints beside those of `reconstruct people`, and rate, delay and cost beside a running rig.

    python -m benchmarks.people.live_people SESSION --seconds 20

SESSION has people and a calibration, such as Pose2Sim's Demo_SinglePerson after an import. First its images
are handed over as a rig's previews are, so many times a second of the recording, as fast as this machine can.
Then cameras replay it in real processes on this machine, and a burst is taken beside it.
"""

import asyncio
import os
import tempfile
import time
from contextlib import AsyncExitStack, aclosing
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import new_parser, print_report, talk
from capture_app import AsyncRig
from capture_app.common.child import Child
from capture_app.rig.live_pictures import live_people
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import PEOPLE, WIDTHS_PX, PeoplePreview
from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.common.geometry import View
from reconstruction.methods.people.live_people import LivePeople

RATE_HZ = 10.0


def session_views(folder: Path) -> dict[str, View]:
    """Return the calibrated views of a session's cameras."""
    session = Session.open(folder)
    calibration = session.calibration()
    assert calibration is not None, "SESSION has no calibration"
    sizes = {camera.name: (camera.facts.width, camera.facts.height) for camera in session.manifest.cameras}
    return {name: View.from_calibration(one, *sizes[name]) for name, one in calibration.cameras.items()}


def compare(folder: Path) -> dict[str, Any]:
    """Return what an instant costs, and distances of live joints from those of all frames, mm for m."""
    session = open_session(folder)
    offline, live = session.people(), LivePeople(session_views(folder))
    times_s, instants_ns = offline.times_s, session.manifest.burst.instants_ns
    step = max(1, round(1e9 / RATE_HZ / session.manifest.burst.period_ns))
    away: list[np.ndarray] = []
    used_s, count, found = 0.0, 0, 0
    for instant in session.instants[::step]:
        images = {}
        for name, view in live.views.items():
            if not (frame := instant.frames[name]).missing:
                size = view.width, view.height
                images[name] = cv2.resize(frame.bgr(), size, interpolation=cv2.INTER_AREA)
        at_s = (instants_ns[instant.number] - instants_ns[0]) / 1e9
        begun_s = time.process_time()
        people = live.find(images, at_s)
        used_s, count, found = used_s + time.process_time() - begun_s, count + 1, found + len(people)
        nearest = int(np.abs(times_s - at_s).argmin())
        there = [offline.positions(n)[nearest] for n in range(1, len(offline.result.people) + 1)]
        for one in people:
            distances = [np.linalg.norm(one.positions - other, axis=1) for other in there]
            known = [row for row in distances if np.isfinite(row).any()]
            if known:
                away.append(min(known, key=lambda row: float(np.nanmedian(row))))
    return {
        "instants": count,
        "people_an_instant": found / count,
        "cpu_ms": used_s / count * 1e3,
        "apart_mm": float(np.nanmedian(away)) * 1e3,
        "apart_90_mm": float(np.nanpercentile(away, 90)) * 1e3,
    }


async def run(folder: Path, seconds: float, images: int, sessions: Path) -> dict[str, Any]:
    """Replay the recording in a rig, and return how often and how late people are found."""
    async with AsyncExitStack() as stack:
        rig = await stack.enter_async_context(AsyncRig(sessions=sessions))
        names = sorted(camera.name for camera in open_session(folder).manifest.cameras)
        for name in names:
            camera = f"replay:{folder},camera={name}"
            words = ("node", "--name", name, "--camera", camera, "--leader", f"{rig.address}")
            child = await Child.start(name, ("capture_app.cli", *words))
            stack.push_async_callback(child.stop)
        status = await rig.wait_until_ready(len(names), 120.0)
        await rig.burst(1)  # which has the recording's calibration
        talk("with live people ...")
        shown: list[PeoplePreview] = []
        first = asyncio.Event()

        async def follow() -> None:
            async with aclosing(live_people(RigLink(rig.address), status, lambda: names[0])) as found:
                async for one in found:
                    shown.append(one)
                    first.set()

        following = asyncio.create_task(follow())
        async with asyncio.timeout(60):
            await first.wait()
        before = len(shown)
        await asyncio.sleep(seconds)
        rate = (len(shown) - before) / seconds
        burst = await rig.burst(images)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
    late_ms = [one.late_ns / 1e6 for one in shown[before:] if one.late_ns is not None]
    frames = [frame for instant in burst.instants for frame in instant.frames.values()]
    return {
        "a_second": rate,
        "late_ms": float(np.median(late_ms)),
        "late_95_ms": float(np.percentile(late_ms, 95)),
        "with_people": float(np.mean([bool(one.people) for one in shown[before:]])),
        "problems": sorted({one.problem for one in shown} - {""}),
        "burst_images": len(frames),
        "burst_missing": sum(bool(frame.missing) for frame in frames),
        "cores": os.cpu_count(),
    }


def show(report: dict[str, Any]) -> None:
    """Print both parts."""
    print(
        "engine: {people_an_instant:.2f} people an instant, {cpu_ms:.0f} CPU-ms; joints {apart_mm:.0f} mm"
        " (90 %: {apart_90_mm:.0f}) from all frames'".format(**report)
    )
    print(
        "rig: {a_second:.1f} instants a second, {late_ms:.0f} ms late (95 %: {late_95_ms:.0f}), people in"
        " {with_people:.0%}; {cores} cores; burst beside it: {burst_images} images, {burst_missing}"
        " missing".format(**report)
    )


def main() -> None:
    """Print two lines, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--images", type=int, default=20, help="of each camera in the burst")
    asked = parser.parse_args()
    talk(f"previews of {WIDTHS_PX[PEOPLE]} px at {RATE_HZ:g} Hz ...")
    report = compare(asked.session)
    with tempfile.TemporaryDirectory() as folder:
        report |= asyncio.run(run(asked.session.resolve(), asked.seconds, asked.images, Path(folder)))
    print_report(report, show, as_json=asked.json)


if __name__ == "__main__":
    main()
