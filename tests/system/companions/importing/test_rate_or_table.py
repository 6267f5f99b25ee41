"""Frames find the frames of the same instant, whatever was dropped and however the table is written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.companions.importing.test_rate_or_table import Numbers, frames_of, timeline_by_table


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=4, max_size=30), st.data())
def test_times_alone_recover_the_instants(
    tmp_path_factory: pytest.TempPathFactory, taken: list[tuple[bool, bool, bool]], data: st.DataObject
) -> None:
    # A fifth of a period of jitter, any frame dropped: the groups are still the right ones.
    taken = [(True, True, True)] * 3 + taken
    lines = ["camera,frame,time_ms"]
    want: list[dict[str, int]] = []
    counts = [0, 0, 0]
    for instant, of in enumerate(taken):
        want.append({})
        for camera, there in enumerate(of):
            if there:
                jitter = data.draw(st.integers(-2000, 2000)) / 1000
                lines.append(f"c{camera},{counts[camera]},{1000 + 10 * instant + jitter}")
                want[-1][f"c{camera}"] = counts[camera]
                counts[camera] += 1
    path = tmp_path_factory.getbasetemp() / "times.csv"
    path.write_text("\n".join(lines))
    timeline = timeline_by_table([Numbers(f"c{n}", range(counts[n])) for n in range(3)], path)
    if 8_000_000 < timeline.period_ns < 12_000_000:  # else most frames were dropped: there is no rate
        assert frames_of(timeline) == [of for of in want if of]
