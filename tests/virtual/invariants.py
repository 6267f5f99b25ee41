"""What must hold at the end of a virtual evening, whatever befell the rig."""

import asyncio
import contextlib
import hashlib
import io
import math
import re
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from capture_app.commands.take import require_whole
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, SimulshotError
from capture_app.machine.repair import repair
from capture_app.plugins.cameras.sound.image_sound import SoundPart, sounds_of
from capture_app.protocol.log import Log
from capture_app.rig.taking import Saved as SavedTake
from capture_app.session.format.burst_plan import PLAN, BurstPlan, read_plan
from capture_app.session.format.manifest import EVENTS, ImageRecord, Manifest
from capture_app.session.format.marks import RIG_MARKS, marks_of
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import MAX_MISSING, judge
from capture_app.session.reading.verify import verify
from tests.virtual.cameras import SOUND_HZ, sound_number, true_ns_of
from tests.virtual.evidence import OrderedBurst, TimeError, Told
from tests.virtual.rig import VirtualRig

BEFORE_S, AFTER_S = 3.0, 6.0
"""A fault this long before a burst's order or after its last instant may cost frames."""
HARMLESS = ("clock-slew", "disk-slow", "late-link")
"""Faults that cost no frame, however long they last."""
SURVIVED = ("kill", "power", "cut", "freeze", "stop")
"""Faults of a leader that a recording of an ordered length survives."""
LONGEST_NS = 60 * 10**9
"""No recording here is ordered to be longer; one without an ordered end is said to last for days."""
MAX_LINES_PER_MINUTE = 120
MAX_HELD_S = 0.1
"""Processor time of one step of a leader's event loop, which hears nobody meanwhile."""
STAMP_NOISE_NS = 20_000
"""More than the noise of a virtual camera's timestamps: five times its deviation."""
RATE_NS = 10_000_000
"""Time over which a clock's rate is taken."""
MAX_BARS = 2.0
"""Maximum error of a time in 95 % uncertainties, where no clock is slewed and links are as assumed."""
MIN_LINKS, MAX_ERRORS = 40, 5.0
"""Over so many links: the mean uncertainty is at most this many times the root mean square error."""
CHANCE = 1e-4
"""Probability with which a run's uncertainties that are right count as too narrow."""
SOUND_ERROR_NS = 30_000_000
"""Maximum error of the time of sound: a microphone's block arrives up to some ms late."""
ENDS = ("kill", "power", "stop")
"""Faults that end a camera's process, which then takes part again once it is ready."""
LOST_S = {"kill": 0.5, "stop": 0.5, "power": 3.0, "freeze": 4.0, "sleep": 1.0}
"""Frames so long before a fault of their camera may be lost: those that its spool did not have yet."""
ASKED_S = 1.5
"""Time within which a camera that has become ready is asked for the rest of a recording."""
MAX_MISSING_PCT = 1.0
"""Missing frames of a recording, in percent, from which `record` has another exit code."""
MAX_OVERRUN_S = 3.0
"""Time within which a recording is over once its operator has ended it."""

Sessions = Mapping[tuple[int, int], "Saved"]
"""Sessions by the key of their burst."""


def broken(rig: VirtualRig) -> Iterator[str]:
    """Yield each broken invariant in words."""
    for machine in sorted(rig.absent_leaders):
        # What it had begun waits there until it leads again, or a person repairs it.
        sessions_folder = rig.world.disks.of(machine).folder / "sessions"
        with contextlib.suppress(SimulshotError):  # there may be nothing to repair
            asyncio.run(repair(sessions_folder, wait_s=0, address=Address("127.0.0.1", 1), log=Log()))
    sessions = sessions_of(rig)
    for look in (
        _opened,
        _confirmed,
        _honest,
        _ordered,
        _told_of_order,
        _long_enough,
        _timed,
        _said,
        _named,
        _cancelled,
        _marked,
        _heard,
        _left_alone,
    ):
        yield from look(rig, sessions)
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

    @cached_property
    def manifest(self) -> Manifest | None:
        """The session's manifest; None if it does not open."""
        return None if self.session is None else self.session.manifest

    def checksums(self) -> dict[tuple[str, int], str]:
        """Return the images' checksums, by camera and instant as ordered."""
        if self.manifest is None or self.plan is None:
            return {}
        images = self.manifest.images
        chosen = self.plan.chosen or range(max((image.instant for image in images), default=0) + 1)
        return {(image.camera, chosen[image.instant]): image.sha256 for image in images}

    @cached_property
    def true_images(self) -> list[tuple[ImageRecord, int, bytes]]:
        """The images of virtual cameras that are as they were taken, with their true times and bytes."""
        found = []
        for image in () if self.session is None or self.manifest is None else self.manifest.images:
            data = b""
            with contextlib.suppress(SimulshotError, OSError):
                data = self.session.image_bytes(image)
            is_whole = self.session is not None and hashlib.sha256(data).hexdigest() == image.sha256
            if (is_whole or self._is_video) and (true := true_ns_of(data)) is not None:
                found.append((image, true[1], data))
        return found

    @property
    def _is_video(self) -> bool:
        """Whether it is a recording, whose frames have no checksums of their own."""
        return self.plan is not None and self.plan.streamed is not None and self.plan.streamed.video


def sessions_of(rig: VirtualRig) -> dict[tuple[int, int], Saved]:
    found = {}
    for machine in ("lead", "lead2"):
        for plan in sorted(rig.world.disks.of(machine).folder.glob(f"sessions/*/{PLAN}")):
            saved = Saved(plan.parent)
            if saved.plan is not None:
                found[saved.plan.key] = saved
    return found


def _judged(rig: VirtualRig, sessions: Sessions) -> Iterator[tuple[OrderedBurst, Saved, Manifest]]:
    """Yield the bursts that have a session which opens."""
    for of in rig.evidence.bursts:
        saved = sessions.get(of.key)
        if saved is not None and saved.manifest is not None:
            yield of, saved, saved.manifest


def _opened(_: VirtualRig, sessions: Sessions) -> Iterator[str]:
    for saved in sessions.values():
        if saved.session is None and (saved.folder / "images").exists():
            yield f"{saved.folder.name} does not open: {saved.error}"
        for problem in saved.problems[:2]:
            yield f"{saved.folder.name}: {problem}"


def _confirmed(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """No image is lost that a node was told is safe, or that it has made safe in its own spool."""
    bursts = {of.key: of for of in rig.evidence.bursts}
    frames = {of.key: of.session.burst.frames for of in rig.evidence.bursts if of.burst.streamed}
    checksums = {key: saved.checksums() for key, saved in sessions.items()}
    lost: defaultdict[tuple[str, tuple[int, int]], list[str]] = defaultdict(list)
    safe = {key: ("synced in its node's spool", *of) for key, of in rig.evidence.synced.items()}
    safe |= {key: ("confirmed", *of) for key, of in rig.evidence.confirmed.items()}
    for image, (what, sha256, at_ns) in sorted(safe.items()):
        *of_burst, camera, instant = image
        key = (of_burst[0], of_burst[1])
        of, saved = bursts.get(key), sessions.get(key)
        if camera in rig.plan.liars:
            continue
        # After an operator has ended a recording its nodes may delete later frames, unconfirmed.
        if what != "confirmed" and instant >= frames.get(key, instant + 1):
            continue
        # Of a take that is cancelled, only what had arrived is saved.
        if (
            of is not None
            and of.cancel_asked_ns is not None
            and (what != "confirmed" or at_ns >= of.cancel_asked_ns)
        ):
            continue
        if what != "confirmed" and (of is None or _is_elsewhere(rig, of, saved, camera, instant)):
            continue
        streamed = None if saved is None or saved.plan is None else saved.plan.streamed
        there = checksums.get(key, {}).get((camera, instant))
        # The frames of a video have no checksums of their own.
        if there is None or (there != sha256 and not (streamed is not None and streamed.video)):
            lost[what, key].append(f"{camera}/{instant}")
    for (what, key), images in lost.items():
        name = sessions[key].folder.name if key in sessions else f"burst {key}, which has no session"
        yield f"{what} and lost: {len(images)} of {name}: {', '.join(images[:5])}"


def _is_elsewhere(rig: VirtualRig, of: OrderedBurst, saved: Saved | None, camera: str, instant: int) -> bool:
    """Return whether an image of a node's spool is still there, or need not be in the session."""
    if saved is not None and saved.plan is not None:
        chosen = saved.plan.chosen
        if chosen is not None and instant not in chosen:
            return True
    # What a leader had begun that does not lead any more waits for it.
    return of.machine in rig.absent_leaders or camera not in of.burst.clients


def _honest(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """Each frame that a camera delivered is saved, if it was ready and nothing befell it or the leader."""
    for of in rig.evidence.bursts:
        if of.cancel_asked_ns is not None or of.machine in rig.absent_leaders:
            continue
        honest = [
            name
            for name in of.ready
            if name not in rig.plan.liars and not _befell(rig, of, name, goes_on=_has_end(of))
        ]
        saved = sessions.get(of.key)
        if saved is None or saved.manifest is None:
            if any(_delivered(rig, of, name, of.burst.instants_ns[0]) for name in honest):
                yield f"{of.name} has no session, and nothing befell {', '.join(honest)}"
            continue
        yield from _whole(rig, of, saved.manifest, honest)


def _whole(rig: VirtualRig, of: OrderedBurst, manifest: Manifest, honest: list[str]) -> Iterator[str]:
    instants_ns = manifest.burst.instants_ns
    there = {(image.camera, image.instant) for image in manifest.images}
    delays_ns = {camera.name: camera.delay_ns for camera in manifest.cameras}
    for name in honest:
        delivered = [
            number
            for number, at_ns in enumerate(instants_ns)
            if _delivered(rig, of, name, at_ns + delays_ns.get(name, 0))
        ]
        if missing := [number for number in delivered if (name, number) not in there]:
            yield (
                f"{of.name} lacks {len(missing)} of the {len(delivered)} frames that {name} delivered, which"
                f" was ready and which nothing befell: at instants {', '.join(map(str, missing[:5]))}"
            )
    if of.burst.video or {*honest} != {*of.burst.clients}:
        return
    if len(instants_ns) < of.burst.frames:
        yield f"{of.name} has {len(instants_ns)} of the {of.burst.frames} instants that were ordered"
    for skipped in manifest.burst.skipped:
        if all(_delivered(rig, of, name, skipped.leader_ns + delays_ns.get(name, 0)) for name in honest):
            yield f"{of.name} skips an instant of which every camera delivered its frame"


def _ordered(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """Each ordered frame of a recording or a long burst is saved whose camera was ready and delivered it.

    What befalls a camera or its leader excuses instants, never a camera: see `_excused`.
    """
    for of, _, manifest in _judged(rig, sessions):
        if not of.burst.streamed or of.cancel_asked_ns is not None or of.machine in rig.absent_leaders:
            continue
        there = {(image.camera, image.instant) for image in manifest.images}
        delays_ns = {camera.name: camera.delay_ns for camera in manifest.cameras}
        until_ns = _judged_until(rig, of)
        for name in sorted({*of.burst.clients} - {*rig.plan.liars}):
            excused, lacking, due = _excused(rig, of, name), [], 0
            for number, leader_ns in enumerate(of.burst.instants_ns):
                at_ns = int(of.clock.true_from_local(leader_ns))
                if at_ns >= until_ns:
                    break
                if any(from_ns <= at_ns <= end_ns for from_ns, end_ns in excused):
                    continue
                if _delivered(rig, of, name, leader_ns + delays_ns.get(name, 0)):
                    due += 1
                    lacking += [] if (name, number) in there else [number]
            if lacking:
                yield (
                    f"{of.name} lacks {len(lacking)} of {due} frames that {name} delivered when it was ready,"
                    f" from instant {lacking[0]} to {lacking[-1]}"
                )


def _judged_until(rig: VirtualRig, of: OrderedBurst) -> float:
    """Return the true time, ns, until which a take's frames are due.

    An operator may end it. A disk that is full or fails breaks it off; without an ordered end so does
    whatever befalls its leader.
    """
    breaks = [
        span.from_ns
        for span in rig.evidence.spans
        if span.target in ("lead", "lead2")
        and span.until_ns >= of.ordered_ns
        and (span.kind in ("disk-full", "disk-failing") or not (_has_end(of) or span.kind in HARMLESS))
    ]
    return min([math.inf if of.end_asked_ns is None else of.end_asked_ns, *breaks])


def _excused(rig: VirtualRig, of: OrderedBurst, camera: str) -> list[tuple[float, float]]:
    """Return the spans of true time, ns, of which a camera owes a take nothing.

    It owes nothing from shortly before its process ends, as its spool may lack the last frames, until its
    leader has seen it ready again; from a fault of its disk before that end, as its frames stay in memory;
    and nothing while it may not have heard the order.
    """
    spans = [span for span in rig.evidence.spans if span.until_ns >= of.ordered_ns - AFTER_S * 1e9]
    own = [span for span in spans if span.target == camera]
    stopped_ns = min(
        (of.from_ns for of in spans if (of.target, of.kind) == ("lead", "stop")), default=math.inf
    )

    def asked_again(after_ns: float) -> float:
        aligned = (at for name, leader, at in rig.evidence.aligned if (name, leader) == (camera, of.machine))
        ready_ns = next((at for at in aligned if at > after_ns), math.inf)
        # A leader that is stopped ends what it takes: nobody is asked for the rest.
        if ready_ns > stopped_ns:
            return math.inf
        # Orders are datagrams, which a slow link delivers as others do: only streams wait there.
        harmless = (*ENDS, *HARMLESS, "slow-link")
        slow = (span.until_ns for span in spans if span.kind not in harmless and span.from_ns <= ready_ns)
        return max([ready_ns, *(end_ns for end_ns in slow if end_ns > ready_ns)]) + ASKED_S * 1e9

    excused = [(-math.inf, asked_again(of.ordered_ns))] if camera not in of.ready else []
    around = {camera, of.machine, *(["relay"] if camera in rig.plan.behind_relay else [])}
    for span in spans:
        is_around = span.from_ns <= of.ordered_ns + BEFORE_S * 1e9
        if is_around and span.target in around and span.kind not in HARMLESS:
            excused.append((-math.inf, span.until_ns + AFTER_S * 1e9))
            if span.target == camera and span.kind in (*ENDS, "camera-lost", "freeze", "sleep", "cut"):
                excused.append((-math.inf, asked_again(span.from_ns)))
    for span in own:
        from_ns = span.from_ns - LOST_S.get(span.kind, 0) * 1e9
        if span.kind in ENDS:
            on_disk = (of.from_ns for of in own if of.kind.startswith("disk-") and of.from_ns <= span.from_ns)
            # What was on its way to a disk that fails stays in memory as well.
            lost_ns = [disk_ns - LOST_S["kill"] * 1e9 for disk_ns in on_disk]
            excused.append((min([from_ns, *lost_ns]), asked_again(span.until_ns)))
        elif span.kind in ("freeze", "sleep"):
            excused.append((from_ns, span.until_ns + AFTER_S * 1e9))
    return excused


def _told_of_order(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """An operator is told how much of the order is there: by numbers, exit code and grade."""
    # Two leaders may each have a recording-001.
    folders = {str(saved.folder): (key, saved) for key, saved in sessions.items()}
    streamed = {of.key: of for of in rig.evidence.bursts if of.burst.streamed}
    for told in (told for take in rig.evidence.takes for told in take.told):
        status = told.status
        if status.session not in folders or told.missing < 0:
            continue
        key, saved = folders[status.session]
        of = streamed.get(key)
        if of is None or saved.plan is None:
            continue
        streamed_as = saved.plan.streamed
        if of.cancel_asked_ns is not None or streamed_as is None:
            continue
        # Without an end, ordered or confirmed, there is nothing to count against.
        if streamed_as.count * streamed_as.step_ns > LONGEST_NS:
            continue
        ordered = streamed_as.count * len({*of.burst.clients, *told.absent})
        lacks = ordered - told.images
        is_whole = False
        with contextlib.suppress(IncompleteError), contextlib.redirect_stderr(io.StringIO()):
            require_whole(SavedTake(1, status, told.verdict), MAX_MISSING_PCT)
            is_whole = True
        wrong = [
            f"{status.expected} were expected" if status.expected != ordered else "",
            f"its leader expected {told.expected}" if told.expected not in (0, ordered) else "",
            "its exit code says that it is whole"
            if is_whole and lacks > MAX_MISSING_PCT / 100 * ordered
            else "",
            "its exit code says that it is not whole" if not is_whole and not lacks else "",
        ]
        if told.verdict is not None:
            is_poor = told.verdict.grade in ("poor", "unknown")
            wrong += [
                f"the verdict expects {told.verdict.expected}" if told.verdict.expected != ordered else "",
                f"it is {told.verdict.grade}" if lacks > MAX_MISSING * ordered and not is_poor else "",
            ]
        if words := ", ".join(filter(None, wrong)):
            yield f"{of.name}: {ordered} images were ordered and {told.images} are there; said was: {words}"


def _delivered(rig: VirtualRig, of: OrderedBurst, camera: str, leader_ns: int) -> bool:
    """Return whether a camera delivered a frame at that time, well within half a period of it."""
    due_ns, within_ns = int(of.clock.true_from_local(leader_ns)), of.burst.period_ns // 3
    stamps_ns = rig.devices[camera].delivered_ns
    place = bisect_left(stamps_ns, due_ns - within_ns)
    return place < len(stamps_ns) and stamps_ns[place] <= due_ns + within_ns


def _befell(
    rig: VirtualRig,
    of: OrderedBurst,
    *cameras: str,
    ends_ns: int | None = None,
    goes_on: bool = False,
) -> bool:
    """Return whether anything befell these cameras or a leader that may have cost frames of a burst.

    A burst that `goes_on` without its leader loses nothing by a cut, or by the leader's loss, some seconds
    after its order.
    """
    begins_ns = min(of.ordered_ns, int(of.clock.true_from_local(of.burst.instants_ns[0]))) - BEFORE_S * 1e9
    ends_ns = of.last_ns() if ends_ns is None else ends_ns
    concerned = {*cameras, of.machine, "lead", "lead2"}
    if {*cameras} & {*rig.plan.behind_relay}:
        concerned.add("relay")
    return any(
        span.target in concerned
        and span.kind not in HARMLESS
        and not (
            goes_on
            and span.kind in (("cut",) if span.target in cameras else SURVIVED)
            and span.from_ns > of.ordered_ns + BEFORE_S * 1e9
        )
        and span.from_ns <= ends_ns + AFTER_S * 1e9
        # Of what was killed, it takes a while until it is ready again.
        and span.until_ns + AFTER_S * 1e9 >= begins_ns
        for span in rig.evidence.spans
    )


def _unheard(rig: VirtualRig, of: OrderedBurst) -> set[str]:
    """Return the machines of which a fault lasted when a burst was ordered, and what is behind a relay so."""
    unheard = {
        span.target
        for span in rig.evidence.spans
        if span.from_ns <= of.ordered_ns + 1e9 and span.until_ns + AFTER_S * 1e9 >= of.ordered_ns
    }
    below = {*rig.plan.behind_relay} if "relay" in unheard else set[str]()
    return unheard | below


def _long_enough(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """A recording goes on until its operator or its order ends it, and not much longer."""
    for of, _, manifest in _judged(rig, sessions):
        asked_ns, instants_ns = of.end_asked_ns, manifest.burst.instants_ns
        # An end that the leader did not confirm may have reached it or not.
        if not of.burst.streamed or of.cancel_asked_ns is not None or (asked_ns and not of.is_ended):
            continue
        ordered_ns = int(of.clock.true_from_local(of.burst.instants_ns[-1]))
        # Every camera may have dropped its last frame.
        ends_ns = ordered_ns - 2 * of.burst.period_ns if asked_ns is None else min(asked_ns, ordered_ns)
        # A cut of all its cameras is no excuse, unless none of them can have learned of it; nor is the loss
        # of a leader that comes back, if an end was ordered.
        goes_on = _has_end(of) and of.machine not in rig.absent_leaders
        if _befell(rig, of, ends_ns=ends_ns, goes_on=goes_on) or not _stayed(rig, of, ends_ns) - _unheard(
            rig, of
        ):
            continue
        last_ns = int(of.clock.true_from_local(instants_ns[-1])) if instants_ns else of.ordered_ns
        if last_ns < ends_ns:
            who = "its order" if asked_ns is None else "its operator"
            yield (
                f"{of.name} has {len(instants_ns)} instants and lacks the last"
                f" {(ends_ns - last_ns) / 1e6:.0f} ms before {who} ended it"
            )
        elif asked_ns is not None and last_ns > asked_ns + MAX_OVERRUN_S * 1e9:
            yield f"{of.name} went on for {(last_ns - asked_ns) / 1e9:.1f} s after its operator had ended it"


def _has_end(of: OrderedBurst) -> bool:
    """Return whether it is a recording of an ordered length, which no operator ended earlier."""
    instants_ns = of.burst.instants_ns
    return of.burst.video and of.end_asked_ns is None and instants_ns[-1] - instants_ns[0] < LONGEST_NS


def _stayed(rig: VirtualRig, of: OrderedBurst, until_ns: int) -> set[str]:
    """Return the honest cameras of a burst whose processes nothing ended until a true time."""
    ended = {
        span.target
        for span in rig.evidence.spans
        if span.kind.startswith(ENDS)
        and of.ordered_ns <= span.from_ns <= until_ns + LOST_S.get(span.kind, 0) * 1e9
    }
    return {*of.burst.clients} - ended - {*rig.plan.liars}


def _timed(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """Times are within their stated errors, and images off their instant say so."""
    is_slewed = any(step.kind == "clock-slew" for step in rig.plan.steps)
    for of, saved, manifest in _judged(rig, sessions):
        # Of each kind and camera, the worst image is enough.
        worst: dict[tuple[str, str], tuple[float, str]] = {}
        lost_ns = _lost_ns(rig, of)
        for image, true_ns, _ in saved.true_images:
            if image.camera in rig.plan.liars or image.hard_bound_ns is None:
                continue
            true_leader_ns = _leader_ns(of, true_ns, lost_ns)
            error_ns = abs(image.leader_ns - true_leader_ns)
            is_typical = not is_slewed and image.camera not in (*rig.plan.lopsided, *rig.plan.phones)
            time = TimeError(image.camera, of.key, error_ns, image.uncertainty_ns or 0, is_typical)
            rig.times.append(time)
            wrong = (*_wrong_error(image, time), *_wrong_residual(image, manifest, true_leader_ns))
            for kind, factor, words in wrong:
                where = f"{of.name}: {image.camera} at {image.instant} {words}"
                worst[kind, image.camera] = max(worst.get((kind, image.camera), (0.0, "")), (factor, where))
        yield from (words for _, words in worst.values())


def _lost_ns(rig: VirtualRig, of: OrderedBurst) -> float:
    """Return the true time at which a burst's leader was lost, if another one took over."""
    taken_ns = min(
        (at for at, machine in rig.evidence.led if at > of.ordered_ns and machine != of.machine),
        default=math.inf,
    )
    ends = (
        span.from_ns
        for span in rig.evidence.spans
        if span.target == of.machine and span.kind in SURVIVED and of.ordered_ns <= span.from_ns <= taken_ns
    )
    return taken_ns if math.isinf(taken_ns) else max(ends, default=taken_ns)


def _leader_ns(of: OrderedBurst, true_ns: int, lost_ns: float) -> int:
    """Return the time of a burst's leader, which goes on at its last rate when that leader is lost.

    The next leader continues it so; what slews the clock of a lost one is in nobody's time.
    """
    if true_ns <= lost_ns:
        return int(of.clock.local_from_true(true_ns))
    last_ns = int(of.clock.local_from_true(int(lost_ns)))
    rate = (last_ns - of.clock.local_from_true(int(lost_ns) - RATE_NS)) / RATE_NS
    return last_ns + round((true_ns - int(lost_ns)) * rate)


def _wrong_error(image: ImageRecord, time: TimeError) -> Iterator[tuple[str, float, str]]:
    """Yield which stated error of an image's time is too small: its kind, by what factor, and in words."""
    bound_ns, bar_ns = image.hard_bound_ns or 0, time.uncertainty_ns
    for kind, limit_ns, stated_ns in (
        ("hard bound", bound_ns, bound_ns),
        *((("95 % uncertainty", MAX_BARS * bar_ns, bar_ns),) if time.is_typical else ()),
    ):
        if time.error_ns > limit_ns + STAMP_NOISE_NS:
            words = f"is {time.error_ns / 1e3:.0f} us off, and its {kind} is {stated_ns / 1e3:.0f}"
            yield kind, time.error_ns / max(1, stated_ns), words


def _wrong_residual(
    image: ImageRecord, manifest: Manifest, true_leader_ns: int
) -> Iterator[tuple[str, float, str]]:
    """Yield if an image is off its instant unmarked, or marked and in time, as `_wrong_error` does."""
    camera = next(camera for camera in manifest.cameras if camera.name == image.camera)
    if camera.phase is None or camera.phase.tolerance_ns is None:
        return
    due_ns, limit_ns = manifest.burst.instants_ns[image.instant] + camera.delay_ns, camera.phase.tolerance_ns
    off_ns, doubt_ns = abs(true_leader_ns - due_ns), (image.hard_bound_ns or 0) + STAMP_NOISE_NS
    if not image.late and off_ns > limit_ns + doubt_ns:
        words = f"is {off_ns / 1e3:.0f} us off its instant, tolerance {limit_ns / 1e3:.0f}, and not marked"
        yield "late", off_ns / limit_ns, words
    if image.late and off_ns < limit_ns - doubt_ns:
        yield (
            "late",
            limit_ns / max(1, off_ns),
            f"is marked as off its instant, and is {off_ns / 1e3:.0f} us off",
        )


def misjudged(times: Iterable[tuple[int, TimeError]]) -> Iterator[str]:
    """Yield what is wrong with the uncertainties of a run, from times with their seeds.

    A link's asymmetry, of which a node knows only the distribution, is most of the error, and the same for
    all images: one image of each link counts.
    """
    links = {(seed, of.camera): of for seed, of in times if of.is_typical and of.uncertainty_ns}
    if len(links) < MIN_LINKS:
        return
    errors = [of.error_ns / of.uncertainty_ns for of in links.values()]
    outside = sum(error > 1.0 for error in errors)
    if _at_least(outside, len(errors), 0.05) < CHANCE:
        yield f"95 % uncertainties are too narrow: {outside} of {len(errors)} links have larger errors"
    ratio = 1.0 / max(1e-9, math.sqrt(sum(error**2 for error in errors) / len(errors)))
    if ratio > MAX_ERRORS:
        yield f"95 % uncertainties are {ratio:.1f} times as wide as the errors of {len(errors)} links"


def _at_least(count: int, of: int, chance: float) -> float:
    """Return the probability of so many of so many, each with that chance."""
    # Of more than a thousand, the number of choices is beyond a float's range.
    return sum(
        math.exp(
            math.lgamma(of + 1)
            - math.lgamma(n + 1)
            - math.lgamma(of - n + 1)
            + n * math.log(chance)
            + (of - n) * math.log1p(-chance)
        )
        for n in range(count, of + 1)
    )


def _said(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """What an operator was told was so on the disk then, and is no better than what is there now."""
    folders = {str(saved.folder): saved for saved in sessions.values()}
    for take in rig.evidence.takes:
        for told in take.told:
            if (path := told.status.session) is None:
                continue
            name, received = told.status.name, told.status.received
            saved = folders.get(path)
            if saved is None or saved.manifest is None:
                yield f"{take.step}: said to be saved as {name}, which does not open"
            elif len(saved.manifest.images) < received:
                yield f"{name}: {received} images said, {len(saved.manifest.images)} there"
            yield from _true_words(told)


def _true_words(told: Told) -> Iterator[str]:
    status, verdict = told.status, told.verdict
    if told.missing < 0:
        return
    if told.received > told.images:
        yield f"{status.name}: {told.received} images were said to be there, and {told.images} were"
    if verdict is not None and verdict.images > told.images:
        yield f"{status.name}: the verdict counts {verdict.images} images, and {told.images} were there"
    # What a leader said before it was lost is not about the end.
    if "after its leader was lost" in status.message:
        return
    said = re.search(r"(\d+) images? missing", status.message)
    if told.missing > (int(said[1]) if said else 0):
        yield (
            f"{status.name}: {told.missing} images were missing when it was saved, and its operator was told:"
            f" {status.message or 'nothing'!r}"
        )
    if said and status.received + int(said[1]) > status.expected:
        yield f"{status.name}: said was {said[0]}, and {status.received} of {status.expected} were there"
    for name in told.absent:
        if name not in status.message:
            yield f"{status.name}: it was taken without {name}, and its operator was not told"


def _named(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """A camera that an operator saw ready takes part in the takes after that, or they name it as absent."""
    for of, _, manifest in _judged(rig, sessions):
        absent = {camera.name for camera in manifest.burst.absent}
        headline = judge(manifest).headline
        for name in sorted(
            of.seen & {*rig.plan.cameras} - absent - {camera.name for camera in manifest.cameras}
        ):
            # One that was ended in good order has left.
            if not any(span.target == name and span.kind == "stop" for span in rig.evidence.spans):
                yield f"{of.name} does not name {name}, which was ready before its order: {headline}"
        for name in absent:
            if name not in headline:
                yield f"the verdict on {of.name} does not name {name}, which took no part: {headline}"


def _cancelled(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """A cancelled take has no image that was taken well after its cancellation."""
    for of, saved, _ in _judged(rig, sessions):
        if of.cancelled_ns is None or _befell(rig, of, *of.burst.clients):
            continue
        late = [
            image.camera
            for image, true_ns, _ in saved.true_images
            if true_ns > of.cancelled_ns + AFTER_S * 1e9
        ]
        if late:
            yield f"{of.name} has {len(late)} images that were taken after it was cancelled"


def _marked(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """A mark is in the takes that its operator was told, at the time when it was placed."""
    for mark in rig.evidence.marks:
        error_ns = abs(mark.placed.mark.leader_ns - mark.clock.local_from_true(mark.true_ns))
        if error_ns > mark.placed.mark.uncertainty_ns:
            yield (
                f"{mark.text} is {error_ns / 1e3:.0f} us off, and said to be off by at most"
                f" {mark.placed.mark.uncertainty_ns / 1e3:.0f}"
            )
        takes = [
            of
            for of in rig.evidence.bursts
            if of.machine == mark.machine
            and of.cancel_asked_ns is None
            and max(of.ordered_ns, int(of.clock.true_from_local(of.burst.instants_ns[0]))) < mark.true_ns
            and mark.over_ns
            < int(of.clock.true_from_local(of.session.burst.instants_ns[: of.burst.frames][-1]))
            and not _befell(rig, of, *of.burst.clients, ends_ns=mark.over_ns)
        ]
        for of in takes:
            if of.name not in mark.placed.sessions:
                yield f"{mark.text} was placed during {of.name}, and its operator was told otherwise"
        # A power cut may take what was written last; a kill may not.
        if any(span.target == mark.machine and span.kind == "power" for span in rig.evidence.spans):
            continue
        folder = rig.world.disks.of(mark.machine).folder / "sessions"
        files = [folder / name / EVENTS for name in mark.placed.sessions] or [folder / RIG_MARKS]
        for file in files:
            lines = file.read_bytes().splitlines() if file.exists() else []
            # A take without any image leaves no session.
            if file.parent.exists() and mark.placed.mark not in marks_of(lines):
                yield f"{mark.text} is not in {file.parent.name}/{file.name}, as its operator was told"


def _left_alone(rig: VirtualRig, _: Sessions) -> Iterator[str]:
    """No file of a spool is gone or changed that no node wrote, nor any behind a link there."""
    for file, data in rig.foreign.items():
        if not file.exists() or file.read_bytes() != data:
            yield f"a file that no node wrote is gone or changed: {file.relative_to(rig.world.disks.root)}"


def _heard(rig: VirtualRig, sessions: Sessions) -> Iterator[str]:
    """Each image's sound is what was heard then, and none of it is in two images.

    A frame of two takes is encoded once, with the sound since what was encoded before it. What the other take
    encodes later, and is older, carries that sound again.
    """
    if not rig.plan.has_sound:
        return
    name = rig.plan.cameras[0]
    takes_of = Counter(
        true_ns
        for saved in sessions.values()
        for image, true_ns, _ in saved.true_images
        if image.camera == name
    )
    for of, saved, _ in _judged(rig, sessions):
        parts = [
            (part, image.instant, true_ns)
            for image, true_ns, data in saved.true_images
            if image.camera == name
            for part in sounds_of(data)
        ]
        for (one, first, one_ns), (part, second, other_ns) in pairwise(sorted(parts)):
            is_twice = one.stream == part.stream and part.first < one.first + one.samples
            if is_twice and takes_of[max(one_ns, other_ns)] == 1:
                yield f"{of.name}: images {first} and {second} of {name} have the same sound"
        for part, instant, true_ns in parts:
            if not _befell(rig, of, name):
                yield from (
                    f"{of.name}: sound of {name} at {instant} {why}"
                    for why in _wrong(rig, name, part, true_ns)
                )


def _wrong(rig: VirtualRig, name: str, part: SoundPart, image_ns: int) -> Iterator[str]:
    """Yield what is wrong with a part of a virtual microphone's sound, whose samples are their numbers.

    `image_ns` is the true time of its image.
    """
    heard, around = np.frombuffer(part.pcm, "<i2").astype(int), 1 << 15
    true_ns = rig.clocks[name].true_from_local(part.local_ns, near_ns=image_ns)
    off = (heard[0] - sound_number(true_ns) + around // 2) % around - around // 2
    if abs(off) / SOUND_HZ * 1e9 > SOUND_ERROR_NS:
        yield f"is {off / SOUND_HZ * 1e3:.0f} ms off"
    if any((np.diff(heard) % around) != 1):
        yield "has a gap"
