from hypothesis import given
from hypothesis import strategies as st

from capture_app.session.writing.instant_set import InstantSet


@given(st.lists(st.integers(0, 40)), st.sets(st.integers(0, 40)))
def test_it_is_a_set(instants: list[int], others: set[int]) -> None:
    found = InstantSet()
    for instant in instants:
        found.add(instant)
    assert [*found] == sorted({*instants})
    assert len(found) == len({*instants})
    assert found == {*instants}
    assert found == InstantSet(instants)
    assert [n for n in range(45) if n in found] == sorted({*instants})
    assert {*(found & others)} == {*instants} & others
    assert (found >= others) is ({*instants} >= others)
    assert len(found._starts) == sum(n - 1 not in {*instants} for n in {*instants}), "hours in one run"
    assert found.end == max(instants, default=-1) + 1
