"""Dropped and doubled frames of a recording, found by its own times."""

import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.session.importing.embedded_times import video_times_ns
from capture_app.session.importing.frame_matching import Timeline
from capture_app.session.importing.recording_sources import Source, Video

MIN_STEPS = 5
REGULAR = 0.25
"""Maximum relative difference of an interval from the median that counts as regular."""
MIN_REGULAR = 0.7
"""Minimum fraction of regular intervals for a recording to have a rate at all."""
BY_NUMBERS = "; frames are matched by their numbers, so later ones are matched wrongly: take --times video"


def describe_gaps(sources: Sequence[Source], timeline: Timeline, *, by_numbers: bool) -> Iterator[str]:
    """Yield a line for each camera that dropped or doubled frames, by its own times.

    Videos are read for these, without decoding, where the timeline is `by_numbers` of their frames.
    """
    cameras = timeline.cameras()
    for source in sources:
        times_ns, advice = sorted(frame.leader_ns for frame in cameras.get(source.name, ())), ""
        if isinstance(source, Video) and by_numbers:
            with suppress(BadInputError):
                times_ns, advice = video_times_ns(source.path), BY_NUMBERS
        if said := describe_times(times_ns):
            yield f"{source.name}: {said}{advice}"


def describe_times(times_ns: Sequence[int]) -> str:
    """Describe the frames that are missing or came twice by ascending times (ns); "" if there are none."""
    steps_ns = [after - before for before, after in pairwise(times_ns)]
    period_ns = statistics.median(steps_ns) if len(steps_ns) >= MIN_STEPS else 0
    if not period_ns:
        return ""
    regular = sum(abs(step - period_ns) <= REGULAR * period_ns for step in steps_ns) / len(steps_ns)
    if regular < MIN_REGULAR:
        return ""

    def describe(what: str, found: Mapping[int, int]) -> str:
        frame, total = min(found), sum(found.values())
        frames = f"{count(total, 'frame')} {'is' if total == 1 else 'are'} {what}"
        places = "" if len(found) == 1 else f" in {len(found)} places, the first"
        at_s, step_ms = (times_ns[frame] - times_ns[0]) / 1e9, steps_ns[frame] / 1e6
        interval = f"{step_ms:.1f} ms pass instead of {period_ns / 1e6:.1f}"
        return f"{frames}{places} after frame {frame} ({at_s:.2f} s), where {interval}"

    extra = find_extra_steps(steps_ns, period_ns)
    missing = {frame: frames for frame, frames in extra.items() if frames > 0}
    doubled = {frame: -frames for frame, frames in extra.items() if frames < 0}
    return "; ".join(
        describe(what, instants)
        for what, instants in (("missing", missing), ("doubled", doubled))
        if instants
    )


def find_extra_steps(steps_ns: Sequence[int], period_ns: float) -> dict[int, int]:
    """Return how many frames are missing after a frame (negative: too many) by its number, from intervals.

    A late or early frame, whose next one is on time, is none of them: neighbouring intervals make up for it.
    """
    gaps: dict[int, int] = {}
    for number, step_ns in enumerate(steps_ns):
        extra = round(step_ns / period_ns) - 1
        if extra * gaps.get(number - 1, 0) < 0:
            extra += gaps.pop(number - 1)
        if extra:
            gaps[number] = extra
    return gaps
