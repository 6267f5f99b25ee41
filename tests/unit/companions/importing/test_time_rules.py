"""The table of times: in each combination of options and sources, one rule makes the times and says so."""

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, get_args

import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions, TimeSource
from capture_app.companions.importing.times import rules
from capture_app.companions.importing.times.rules import (
    BY_PLACE,
    EQUAL_NUMBERS,
    make_times,
)
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.importing.frame_matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importing.recording_sources import FOLDER, Images, Layout, Source, Video, numbers_in

MS = 1_000_000
NAMED = {
    "a": [1_700_000_000_000 + 40 * k for k in range(6)],
    "b": [1_700_000_000_007 + 40 * k for k in (0, 2, 3, 4, 5)],
}
"""Times in the names of two cameras' images, ms: the second one is late and lacks one."""
OWN, WROTE, PHONES = "counts from its own beginning", "its program wrote", "own table of times"
LATE_MS = {
    "file names": 7, "EXIF": 5, OWN: 11, WROTE: 13, PHONES: 15, "table.csv": 17, "given.csv": 19,
    EQUAL_NUMBERS: 0, BY_PLACE: 0, "have no times": 0,
}  # fmt: skip
"""By how much b is late, ms, by the words of each rule's sentence."""
STATES = dict.fromkeys(LATE_MS, "recorded") | {
    "file names": "given", EQUAL_NUMBERS: "given", BY_PLACE: "given",
    "EXIF": "unknown", OWN: "unknown", "have no times": "unknown",
}  # fmt: skip
SHIFT_MS = 3.0


class Clip(Video):
    """A video of 25 frames a second; b's begins 11 ms later by its own times."""

    def __init__(self, name: str, count: int, embedded: bool = False) -> None:
        self.name, self.path, self.fps = name, Path(f"{name}.mp4"), 25.0
        self.numbers = range(count)
        self.name_numbers = [(number,) for number in self.numbers]
        self._embedded = embedded

    def own_times_ns(self) -> Sequence[int]:
        return [at * MS for at in times_ms(self.name, OWN, len(self.numbers))]

    def embedded_times(self) -> Sequence[TimedFrame] | None:
        return frames(self.name, PHONES, len(self.numbers)) if self._embedded else None

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        raise NotImplementedError


def times_ms(name: str, by: str, count: int) -> list[int]:
    return [40 * k + (LATE_MS[by] if name == "b" else 0) for k in range(count)]


def frames(name: str, by: str, count: int) -> list[TimedFrame]:
    return [TimedFrame(k, at * MS) for k, at in enumerate(times_ms(name, by, count))]


def images(name: str, files: Sequence[str]) -> Images:
    source = Images(name, Path(name), [Path(name, file) for file in files], FOLDER)
    source.name_numbers = [numbers_in(Path(file).stem) for file in files]
    return source


def program() -> Layout:
    clips = Clip("a", 6), Clip("b", 5)
    cameras = {clip.name: frames(clip.name, WROTE, len(clip.numbers)) for clip in clips}
    return Layout(path=Path("x"), sources=clips, timeline=timeline_by_times("it", cameras))


def clips(embedded: bool = False, **others: Any) -> Layout:
    return Layout(path=Path("x"), sources=(Clip("a", 6, embedded), Clip("b", 5, embedded)), **others)


def layout(*sources: Source) -> Layout:
    return Layout(path=Path("x"), sources=sources)


NUMBERS = {"a": [f"{n:04}.jpg" for n in range(6)], "b": [f"{n:04}.jpg" for n in (0, 2, 3, 4, 5)]}
LAYOUTS: dict[str, Callable[[], Layout]] = {
    "numbered": lambda: layout(*(images(*of) for of in NUMBERS.items())),
    "named": lambda: layout(*(images(of, [f"{at}.jpg" for at in times]) for of, times in NAMED.items())),
    "photos": lambda: layout(images("a", ["1.jpg"]), images("b", ["1.jpg"])),
    "videos": clips,
    "tables of phones": lambda: clips(embedded=True),
    "mixed": lambda: layout(Clip("a", 6), images("b", NUMBERS["b"])),
    "a program's times": program,
    "a program's table": lambda: clips(timestamps=(("", Path("table.csv")),)),
    "a program's equal frames": lambda: clips(same_frames=True),
}
OPTIONS = [
    ImportOptions(
        times=times,
        fps=fps,
        timestamps=table,
        synchronized=equal,
        offsets_ms=shift,
        uncertainty_ms=bar,
    )
    for times, fps, table, equal, shift, bar in product(
        get_args(TimeSource),
        (None, 25.0),
        ((), [("", Path("given.csv"))]),
        (False, True),
        ({}, {"b": SHIFT_MS}),
        (None, 2.0),
    )
]


@pytest.fixture(autouse=True)
def read_no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """EXIF and tables state times without a file."""

    def by_exif(path: Path) -> int:
        number = numbers_in(path.stem)[0]
        index = number if number < 100 else (number - NAMED["a"][0]) // 40
        return times_ms(path.parent.name, "EXIF", 9)[index] * MS

    def by_tables(
        sources: Sequence[Source], tables: Sequence[tuple[str, Path]]
    ) -> tuple[Timeline, list[str]]:
        by = tables[0][1].name
        return timeline_by_times(
            by, {one.name: frames(one.name, by, len(one.numbers)) for one in sources}
        ), []

    monkeypatch.setattr(rules, "exif_time_ns", by_exif)
    monkeypatch.setattr(rules, "timeline_by_tables", by_tables)
    monkeypatch.setattr(rules, "describe_gaps", lambda sources, timeline, by_numbers: ())


def shown(layout: Layout, name: str, index: int) -> int:
    """The number of a frame, as its file's name has it."""
    source = next(source for source in layout.sources if source.name == name)
    return source.name_numbers[index][0]


def check(layout: Layout, options: ImportOptions, timeline: Timeline, common: CommonTimes) -> None:
    """The sentence is of the rule that made the times, and the state is what is known of these."""
    (by,) = [by for by in LATE_MS if by in common.reason] or [""]
    shift = SHIFT_MS if options.offsets_ms else 0
    assert ("--time-shift-ms" in common.reason) == bool(shift)
    corrected = shift or options.uncertainty_ms is not None
    if common.reason in ("--time-shift-ms", "--uncertainty-ms"):
        assert (common.state, bool(corrected)) == ("given", True)
        return
    assert common.state == ("given" if shift else STATES[by])
    for one in timeline.instants:
        if {"a", "b"} <= one.frames.keys():
            a, b = one.frames["a"], one.frames["b"]
            late_ms = (b.leader_ns - a.leader_ns) / MS
            rate = options.fps is not None and by == OWN
            # The nearest frame of 40 ms.
            assert (late_ms - shift - (0 if rate else LATE_MS[by])) % 40 == 0
            if by == EQUAL_NUMBERS and not shift:
                assert shown(layout, "a", a.index) == shown(layout, "b", b.index)


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_combination_is_one_rule_or_a_refusal(name: str) -> None:
    imported = 0
    for options in OPTIONS:
        layout = LAYOUTS[name]()
        try:
            times = make_times(layout, options)
        except BadInputError:
            continue
        assert times.common is not None
        check(layout, options, times.timeline, times.common)
        imported += 1
    assert imported > 5


@pytest.mark.parametrize(
    "options",
    [
        ImportOptions(times="exif", synchronized=True),
        ImportOptions(times="name", synchronized=True),
        ImportOptions(synchronized=True, offsets_ms={"b": 1.0}),
        ImportOptions(synchronized=True, timestamps=[("", Path("given.csv"))]),
    ],
)
def test_synchronized_beside_other_times_is_refused(options: ImportOptions) -> None:
    with pytest.raises(BadInputError, match="--synchronized pairs frames of equal number, --"):
        make_times(LAYOUTS["numbered"](), options)


def test_what_the_user_says_goes_before_what_a_program_stored() -> None:
    times = make_times(LAYOUTS["a program's table"](), ImportOptions(synchronized=True))
    assert times.common == CommonTimes(state="given", reason=EQUAL_NUMBERS)
