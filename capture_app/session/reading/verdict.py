"""Verdict on a burst: its synchronization quality and the motion it tolerates; every view shows this one."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Literal

from msgspec import Struct

from capture_app.common.camera_facts import unmeasured_stamps
from capture_app.common.grouping import grouped
from capture_app.common.text import count, duration
from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from capture_app.session.format.manifest import (
    Manifest,
    SkippedInstant,
    SyncRecord,
    computed_sync,
)

PX_PER_S = 1000.0
"""Motion assumed in verdicts, px/s: a person who runs through the image in one or two seconds."""


Grade = Literal["excellent", "good", "fair", "poor", "unknown"]
"""Displacement between cameras of an object at `PX_PER_S`, including the uncertainty of the image times.

Excellent, good and fair are below 0.1, 1 and 10 px. Unknown: there is no image, no instant has two images,
or the uncertainty of their times is unknown. Poor also if more than `MAX_MISSING` of the images are missing.
The camera that lacks the largest part of its frames caps the grade, by `LOSS_LIMITS`.
"""


UNSYNCHRONIZED_SENTENCE = (
    "images are paired by each camera's own times, which say nothing of the others': "
    "reconstruct time --apply aligns them by what moves"
)
LONE_INSTANT_SENTENCE = (
    "images of one instant show no motion by which to align them: import --synchronized vouches for them"
)
MAX_MISSING = 1 / 3
"""Fraction of missing images above which a take is poor, whatever its synchronization."""
LOSS_LIMITS: tuple[tuple[float, Grade], ...] = ((0.01, "excellent"), (0.1, "good"), (1.0, "fair"))
"""The best grade up to each fraction of frames that the worst camera lacks; 1 is all of them."""
MIN_COMMON_GAP = 10
"""Consecutive instants without any image from which their times are named."""
_LIMITS_PX: tuple[tuple[float, Grade], ...] = ((0.1, "excellent"), (1.0, "good"), (10.0, "fair"))
GRADE_LIMITS = "spread and error together: " + ", ".join(
    f"{grade} below {duration(limit / PX_PER_S * 1e9)}" for limit, grade in _LIMITS_PX
)
"""The grades' limits as times."""


class Verdict(Struct, frozen=True, kw_only=True):
    """The verdict on a take; times in ns, None if unknown."""

    grade: Grade
    headline: str
    """The grade and the motion it allows, in one short sentence."""
    sentence: str
    """Effect of the time differences on a moving object, in one sentence."""
    spread_ns: int | None = None
    """Peak-to-peak time of the worst instant: from its first to its last image, without planned delays."""
    spread_error_ns: int | None = None
    """95 % uncertainty of the spread: twice the uncertainty of the worst image's time."""
    motion_px_per_s: float | None = None
    """Speed below which an object is displaced by less than 1 px, including the uncertainty of the times.

    None also for a staggered session, whose images show an object at different places on purpose.
    """
    images: int = 0
    expected: int = 0
    dropped: int = 0
    """Number of missing images that a camera dropped."""
    substituted: int = 0
    late: int = 0
    stamps: str = ""
    """Cameras with unmeasured timestamp delay and the command that measures it; empty if irrelevant here."""

    @property
    def spread(self) -> str:
        """The spread with its uncertainty: 63 µs ±18 µs."""
        return describe_spread(self.spread_ns, self.spread_error_ns)


def describe_spread(spread_ns: int | None, error_ns: int | None) -> str:
    """Return a spread with its 95 % uncertainty, if that is known: 63 µs ±18 µs."""
    error = "" if None in (spread_ns, error_ns) else f" ±{duration(error_ns)}"
    return duration(spread_ns) + error


def judge(manifest: Manifest, *, arriving: bool = False) -> Verdict:
    """Judge a take by its spread, its uncertainty and its missing images, unless these are `arriving`."""
    sync, times = find_sync_record(manifest), manifest.burst.common_times
    unknown = times is not None and times.unknown
    images = Counter(image.instant for image in manifest.images)
    spreads = [spread for instant, spread in enumerate(sync.spread_ns) if images[instant] > 1]
    # Times without a common clock have no spread.
    spread_ns = None if unknown else max(spreads, default=None)
    error_ns = None if sync.uncertainty_ns is None else 2 * sync.uncertainty_ns
    grade, motion = grade_of(spread_ns, error_ns)
    recorded = times is not None and times.state == "recorded"
    purpose, sentence = (
        _purpose(grade, motion, spread_ns, recorded=recorded),
        "there are no two images of one instant",
    )
    if manifest.is_staggered and motion is not None:
        purpose = f"staggered, {manifest.steps}: {grade}, each as planned to {duration(1e9 / motion)}"
        motion = None
    seen = {image.camera for image in manifest.images}
    silent = [
        f"{manifest.labels[camera.name]} missing: no image came"
        for camera in manifest.cameras
        if seen and camera.name not in seen
    ]
    absence = ", ".join(filter(None, (manifest.burst.absence, *silent)))
    if unknown:
        purpose = NOT_SYNCHRONIZED
        sentence = UNSYNCHRONIZED_SENTENCE if len(sync.spread_ns) > 1 else LONE_INSTANT_SENTENCE
    elif spreads:
        sentence = describe_displacement(sync, staggered=manifest.is_staggered)
    expected = manifest.expected_images
    missing = expected - len(manifest.images)
    lost, ordered = frames_lost(manifest), manifest.ordered_instants
    capped = cap_grade(grade, max(lost.values(), default=0) / max(1, ordered), missing, expected)
    # Where nothing is known of the times, that comes first.
    named_otherwise = silent or manifest.burst.absent or grade == "unknown"
    worst = "" if named_otherwise else _worst_camera(lost, ordered, manifest.labels)
    gaps = _common_gaps(manifest) if missing else ""
    completeness = "; ".join(filter(None, (absence, worst, _completeness(missing, expected, sync, gaps))))
    if arriving:
        # What nobody took does not arrive.
        here = f"{len(manifest.images)} of {count(expected, 'image')}, {len(manifest.missing)} arriving"
        completeness = "; ".join(filter(None, (manifest.burst.absence, here)))
    headline = f"{purpose}; {completeness}"
    if not manifest.images and not arriving:
        # Nothing was taken whose times could be good or poor.
        grade, headline = "unknown", f"not taken: {_why_nothing(manifest) or completeness}"
        sentence = "there is no image"
    elif not arriving and (absence or worst or capped != grade):
        grade = capped
        headline = f"{grade}: {completeness}; the rest is {purpose}"
    return Verdict(
        grade=grade,
        headline=headline,
        sentence=sentence,
        spread_ns=spread_ns,
        spread_error_ns=error_ns,
        motion_px_per_s=motion,
        images=len(manifest.images),
        expected=expected,
        dropped=sync.dropped,
        substituted=sync.substituted,
        late=sync.late,
        # Old recordings and imports carry no timestamp uncertainty, so it cannot be part of their error.
        stamps=unmeasured_stamps(
            {camera.name: camera.facts for camera in manifest.cameras if camera.facts.stamp}
        ),
    )


def is_incomplete(missing: int, expected: int) -> bool:
    """Return whether more images are missing than a take can lose without the verdict "poor"."""
    return missing > MAX_MISSING * expected


def cap_grade(grade: Grade, loss: float, missing: int, expected: int) -> Grade:
    """Return the grade of a take whose times have this one, capped by the `loss` of its worst camera."""
    if is_incomplete(missing, expected):
        return "poor"
    grades = [name for _, name in LOSS_LIMITS]
    cap = next((name for limit, name in LOSS_LIMITS if loss <= limit), grades[-1])
    return max(grade, cap, key=grades.index) if grade in grades else grade


def frames_lost(manifest: Manifest) -> dict[str, int]:
    """Return the number of ordered frames that each camera lacks; an absent one lacks all."""
    images, frames = Counter(image.camera for image in manifest.images), Counter[str]()
    for video in manifest.videos:
        frames[video.camera] += video.frames
    cameras = [
        *(camera.name for camera in manifest.cameras),
        *(absentee.name for absentee in manifest.burst.absent),
    ]
    return {camera: manifest.ordered_instants - (images[camera] or frames[camera]) for camera in cameras}


def find_sync_record(manifest: Manifest) -> SyncRecord:
    """Return the manifest's synchronization record; if it lacks instants, compute it from the images."""
    sync, instants = manifest.sync, len(manifest.burst.instants_ns)
    return sync if sync and len(sync.spread_ns) == instants else computed_sync(manifest)


def describe_displacement(sync: SyncRecord, px_per_s: float = PX_PER_S, *, staggered: bool = False) -> str:
    """Describe in one sentence the displacement between cameras of an object at this speed.

    In a staggered session it is the displacement beside the planned one.
    """
    worst_ns = max(sync.spread_ns, default=0)
    by = f"{pixels(worst_ns, px_per_s)} between cameras" + (" beside the planned steps" if staggered else "")
    cost = f"an object moving at {px_per_s:g} px/s is displaced by {by}"
    if sync.uncertainty_ns is None:
        return f"{cost}, if the times are right: their uncertainty is not known"
    error_px = pixels(worst_ns + 2 * sync.uncertainty_ns, px_per_s)
    text = f"{cost} at most, {error_px} with the error of their times included"
    if sync.hard_bound_ns is not None:
        text += f" (95 %; never more than {pixels(worst_ns + 2 * sync.hard_bound_ns, px_per_s)})"
    return text


def pixels(time_ns: int, px_per_s: float = PX_PER_S) -> str:
    """Describe the distance that an object at this speed moves in `time_ns`."""
    distance = px_per_s * time_ns * 1e-9
    return f"{distance:.2f} px" if distance < 9.995 else f"{distance:,.0f} px"


def grade_of(spread_ns: int | None, error_ns: int | None) -> tuple[Grade, float | None]:
    """Return the grade of a spread with its error, and the motion (px/s) that it displaces by 1 px."""
    if spread_ns is None or error_ns is None:
        return "unknown", None
    sure_ns = max(1, spread_ns + error_ns)
    fitting: Iterator[Grade] = (grade for limit, grade in _LIMITS_PX if PX_PER_S * sure_ns * 1e-9 < limit)
    return next(fitting, "poor"), 1e9 / sure_ns


def _why_nothing(manifest: Manifest) -> str:
    """Return the reasons for which a take has no image, each with its cameras; empty if none is recorded."""
    labels = manifest.labels
    reasons = grouped((gap.reason, labels[gap.camera]) for gap in manifest.missing)
    absent = [f"{absentee.label or absentee.name}: {absentee.reason}" for absentee in manifest.burst.absent]
    reasons_given = [f"{', '.join(dict.fromkeys(cameras))}: {reason}" for reason, cameras in reasons.items()]
    return "; ".join([*reasons_given, *absent])


def _purpose(grade: Grade, motion: float | None, spread_ns: int | None, *, recorded: bool) -> str:
    if motion is None:
        return (
            "nothing to compare: no two images of one instant"
            if spread_ns is None
            else "not measured: no times were recorded, equal numbers are taken as one instant"
            if not (spread_ns or recorded)
            else f"not measured: {duration(spread_ns)} apart by the recorded times, whose error is not known"
        )
    return f"{grade}: within a pixel for motion up to {float(f'{motion:.2g}'):,.0f} px/s"


def _worst_camera(lost: dict[str, int], ordered: int, titles: Mapping[str, str]) -> str:
    """Name the camera that lacks most frames, if it lacks more than others and than costs nothing."""
    name = max(lost, key=lost.__getitem__, default="")
    if not name or lost[name] <= LOSS_LIMITS[0][0] * ordered or lost[name] == min(lost.values()):
        return ""
    return f"{titles[name]} lacks {lost[name]} of {count(ordered, 'frame')}"


def _completeness(missing: int, expected: int, sync: SyncRecord, gaps: str) -> str:
    images = count(expected, "image")
    notes = (
        (missing and sync.dropped, "dropped by the camera"),
        (sync.substituted, "from the frame beside it"),
        (sync.late, "off the instant"),
    )
    there = f"{missing} of {images} missing" if missing else f"all {images} there"
    counted = (f"{number} {what}" for number, what in notes if number)
    return ", ".join(filter(None, (there, *counted, gaps)))


def _common_gaps(manifest: Manifest) -> str:
    """Return in words when no camera has an image, for MIN_COMMON_GAP instants or more; empty for never."""
    instants_ns, taken = manifest.burst.instants_ns, {image.instant for image in manifest.images}
    gaps = []
    for is_taken, numbers in groupby(range(len(instants_ns)), taken.__contains__):
        gap = [] if is_taken else [*numbers]
        if len(gap) >= MIN_COMMON_GAP:
            from_s, until_s = ((instants_ns[n] - instants_ns[0]) * 1e-9 for n in (gap[0], gap[-1]))
            gaps.append(f"{from_s:.1f} to {until_s:.1f} s")
    return f"no camera delivered any from {' and '.join(gaps)}" if gaps and taken else ""


def skipped_text(skipped: Sequence[SkippedInstant], titles: Mapping[str, str]) -> str:
    """Describe the skipped instants and why: "1 instant skipped: cam03 dropped 1 frame"; empty for none.

    `titles` is what people call each camera.
    """
    if not skipped:
        return ""
    gaps = [gap for instant in skipped for gap in instant.missing]
    dropped = Counter(gap.camera for gap in gaps if gap.dropped)
    others = dict.fromkeys(
        f"{titles.get(gap.camera, gap.camera)}: {gap.reason}" for gap in gaps if not gap.dropped
    )
    reasons = [
        f"{titles.get(camera, camera)} dropped {count(frames, 'frame')}"
        for camera, frames in sorted(dropped.items())
    ]
    why = ", ".join([*reasons, *others]) or "not every camera had its frame"
    return f"{count(len(skipped), 'instant')} skipped: {why}"
