"""What must hold at the end of a virtual evening, whatever befell the rig."""

import asyncio
import contextlib
import hashlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.machine.repair import repair
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.virtual.cameras import true_ns_of
from tests.virtual.rig import OrderedBurst, VirtualRig

BEFORE_S, AFTER_S = 3.0, 6.0
"""A fault this long before a burst's order or after its last instant may cost frames."""
MIN_TIMES, MIN_COVERAGE = 20, 0.9
"""Fraction of the 95 % bars that hold the true time, of so many or more, where no clock is slewed."""
MAX_LINES_PER_MINUTE = 120
MAX_HELD_S = 0.1
"""Processor time of one step of a leader's event loop, which hears nobody meanwhile."""


def broken(rig: VirtualRig) -> Iterator[str]:
    """Yield each broken invariant in words."""
    for machine in sorted(rig.absent_leaders):
        # What it had begun waits there until it leads again, or a person repairs it.
        sessions_folder = rig.world.disks.of(machine).folder / "sessions"
        with contextlib.suppress(SimulshotError):  # there may be nothing to repair
            asyncio.run(repair(sessions_folder, wait_s=0, address=Address("127.0.0.1", 1), log=Log()))
    sessions = sessions_of(rig)
    yield from _opened(sessions)
    yield from _confirmed(rig, sessions)
    yield from _honest(rig, sessions)
    yield from _timed(rig, sessions)
    yield from _said(rig, sessions)
    for folder, files in Counter(str(Path(file).parent) for file in rig.spooled(rig.absent_leaders)).items():
        yield f"left in a spool: {files} images in {folder}"
    minutes = rig.world.elapsed_s() / 60
    for name, lines in rig.evidence.log_lines.items():
        if name not in rig.plan.liars and lines > MAX_LINES_PER_MINUTE * (minutes + 1):
            yield f"{name} wrote {lines} lines in {minutes:.1f} minutes"
    for machine in rig.works:
        for file in sorted({*rig.world.disks.of(machine).syncs_on_loop}):
            yield f"{machine} synced {file} on its event loop"
        held_s = rig.world.longest_step_ns.get(machine, 0) / 1e9
        if machine in ("lead", "lead2") and held_s > MAX_HELD_S:
            yield f"{machine}'s event loop was held for {1000 * held_s:.0f} ms by one step"


class Saved:
    """A session as it is on disk at the end."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.error = folder, ""
        self.problems: list[str] = []
        self.plan: BurstPlan | None = None
        self.session: Session | None = None
        try:
            self.plan = read_plan(folder)
        except SimulshotError as error:
            self.error = str(error)
            return
        try:
            self.session = Session.open(folder)
            self.problems = [str(problem) for problem in verify(self.session)]
        except SimulshotError as error:
            self.error = str(error)

    def checksums(self) -> dict[tuple[str, int], str]:
        """Return the images' checksums, by camera and instant as ordered."""
        if self.session is None or self.plan is None:
            return {}
        images = self.session.manifest.images
        chosen = self.plan.chosen or range(max((image.instant for image in images), default=0) + 1)
        return {(image.camera, chosen[image.instant]): image.sha256 for image in images}


def sessions_of(rig: VirtualRig) -> dict[tuple[int, int], Saved]:
    found = {}
    for machine in ("lead", "lead2"):
        for plan in sorted(rig.world.disks.of(machine).folder.glob(f"sessions/*/{PLAN}")):
            saved = Saved(plan.parent)
            if saved.plan is not None:
                found[saved.plan.key] = saved
    return found


def _opened(sessions: dict[tuple[int, int], Saved]) -> Iterator[str]:
    for saved in sessions.values():
        if saved.session is None and (saved.folder / "images").exists():
            yield f"{saved.folder.name} does not open: {saved.error}"
        for problem in saved.problems[:2]:
            yield f"{saved.folder.name}: {problem}"


def _confirmed(rig: VirtualRig, sessions: dict[tuple[int, int], Saved]) -> Iterator[str]:
    """No image is lost that a node was told is safe."""
    cancelled = {of.key for of in rig.evidence.bursts if of.cancelled}
    by_key: dict[tuple[int, int], dict[tuple[str, int], str]] = {}
    lost: dict[tuple[int, int], list[str]] = {}
    for (leader, burst, camera, instant), sha256 in sorted(rig.evidence.confirmed.items()):
        key = (leader, burst)
        if key in cancelled or camera in rig.plan.liars:
            continue
        if key not in by_key:
            by_key[key] = sessions[key].checksums() if key in sessions else {}
        saved = sessions.get(key)
        streamed = None if saved is None or saved.plan is None else saved.plan.streamed
        there = by_key[key].get((camera, instant))
        # The frames of a video have no checksums of their own.
        if there is None or (there != sha256 and not (streamed is not None and streamed.video)):
            lost.setdefault(key, []).append(f"{camera}/{instant}")
    for key, images in lost.items():
        name = sessions[key].folder.name if key in sessions else f"burst {key}, which has no session"
        yield f"confirmed and lost: {len(images)} of {name}: {', '.join(images[:5])}"


def _honest(rig: VirtualRig, sessions: dict[tuple[int, int], Saved]) -> Iterator[str]:
    """A camera that was ready, and that nothing befell, is whole in its burst."""
    for of in rig.evidence.bursts:
        if of.cancelled or of.session.order_end is not None or of.machine in rig.absent_leaders:
            continue
        saved = sessions.get(of.key)
        there = {} if saved is None else saved.checksums()
        frames = of.burst.frames
        for camera in of.ready:
            if camera in rig.plan.liars or rig.plan.drops or _is_excused(rig, of, camera):
                continue
            received = sum(name == camera for name, _ in there)
            if received < frames:
                yield (
                    f"{of.name} has {received} of {frames} images of {camera}, which was ready"
                    + ("" if saved is not None else "; there is no session")
                )


def _is_excused(rig: VirtualRig, of: OrderedBurst, camera: str) -> bool:
    begins_ns = min(of.ordered_ns, int(of.clock.true_from_local(of.burst.instants_ns[0]))) - BEFORE_S * 1e9
    ends_ns = of.last_ns() + AFTER_S * 1e9
    concerned = {camera, of.machine, "lead", "lead2"}
    if camera in rig.plan.behind_relay:
        concerned.add("relay")
    return any(
        span.target in concerned
        and span.from_ns <= ends_ns
        # Of what was killed, it takes a while until it is ready again.
        and span.until_ns + AFTER_S * 1e9 >= begins_ns
        for span in rig.evidence.spans
    )


def _timed(rig: VirtualRig, sessions: dict[tuple[int, int], Saved]) -> Iterator[str]:
    """Every image's true time is within its hard bound, and 95 % within the bar."""
    clocks = {of.key: of.clock for of in rig.evidence.bursts}
    inside = total = 0
    for key, saved in sessions.items():
        if saved.session is None or key not in clocks:
            continue
        for image in saved.session.manifest.images:
            file = saved.session.image_file(image)
            if file.suffix != ".jpg" or not file.is_file() or image.hard_bound_ns is None:
                continue
            data = file.read_bytes()
            if hashlib.sha256(data).hexdigest() != image.sha256 or (true := true_ns_of(data)) is None:
                continue
            camera, true_ns = true
            error_ns = abs(image.leader_ns - clocks[key].local_from_true(true_ns))
            # The sensor's own noise, of five times its deviation.
            if camera not in rig.plan.liars and error_ns > image.hard_bound_ns + 20_000:
                yield (
                    f"{saved.folder.name}: {camera} at {image.instant} is {error_ns / 1e3:.0f} us off,"
                    f" and its hard bound is {image.hard_bound_ns / 1e3:.0f}"
                )
            total += 1
            inside += error_ns <= (image.uncertainty_ns or 0) + 20_000
    rig.inside, rig.total = inside, total
    is_slewed = any(step.kind == "clock-slew" for step in rig.plan.steps)
    if not is_slewed and total >= MIN_TIMES and inside < MIN_COVERAGE * total:
        yield f"{inside} of {total} times are within their 95 % bars"


def _said(rig: VirtualRig, sessions: dict[tuple[int, int], Saved]) -> Iterator[str]:
    """What an operator was told is no better than what is on disk."""
    for take in rig.evidence.takes:
        status = take.status
        if status is None or status.session is None or not take.result.endswith("saved"):
            continue
        saved = next((of for of in sessions.values() if str(of.folder) == status.session), None)
        if saved is None or saved.session is None:
            yield f"{take.step}: said to be saved as {status.name}, which does not open"
        elif len(saved.session.manifest.images) < status.received:
            yield (
                f"{status.name}: {status.received} images said, {len(saved.session.manifest.images)} there"
            )
