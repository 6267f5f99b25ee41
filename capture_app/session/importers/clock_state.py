"""Whether the times of a recording's cameras are of one clock, by what the user and the recording say."""

from collections.abc import Sequence

from capture_app.session.format.common_times import CommonTimes, TimesState
from capture_app.session.importers.embedded_times import TimeSource
from capture_app.session.importers.sources import Source, Video
from capture_app.session.importers.time_source import TimeOptions

EQUAL_NUMBERS = "frames of equal number are taken as of one instant"


def clock_state(sources: Sequence[Source], options: TimeOptions) -> CommonTimes | None:
    """The state of the times that `make_timeline` gives these sources; None of one camera alone.

    The rate of videos says nothing of when each began; that of numbered images says which belong together.
    """
    if len(sources) < 2:
        return None
    if options.timestamps is not None:
        return CommonTimes(state=TimesState.RECORDED, reason=f"the table {options.timestamps.name}")
    if options.known is not None and not options.tell_times and not options.offsets_ms:
        return CommonTimes(state=TimesState.RECORDED, reason="the times that its program wrote")
    if options.synchronized:
        return CommonTimes(state=TimesState.GIVEN, reason=EQUAL_NUMBERS)
    if options.offsets_ms:
        return CommonTimes(state=TimesState.GIVEN, reason="--time-shift-ms")
    if options.uncertainty_ms is not None:
        return CommonTimes(state=TimesState.GIVEN, reason="--uncertainty-ms")
    videos = any(isinstance(source, Video) for source in sources)
    if options.fps is not None and not videos:
        return CommonTimes(state=TimesState.GIVEN, reason=EQUAL_NUMBERS)
    if options.times is TimeSource.NAME:
        return CommonTimes(state=TimesState.GIVEN, reason="the times in file names are taken as of one clock")
    if not options.tell_times and all(source.embedded_times() is not None for source in sources):
        return CommonTimes(state=TimesState.RECORDED, reason="the recording's own table of times")
    return CommonTimes(state=TimesState.UNKNOWN, reason=_why(sources, options, videos=videos))


def _why(sources: Sequence[Source], options: TimeOptions, *, videos: bool) -> str:
    if options.times is TimeSource.EXIF:
        return "EXIF tells each camera's own clock"
    if not videos:
        return "nothing tells when these images were taken"
    return "each video counts from its own beginning"
