"""Which instants a burst gets: the first that every camera has, as soon as that is known."""

from hypothesis import given
from hypothesis import strategies as st

from capture_app.node.burst.plans import choose_instants
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, MissingImage
from tests.facts import make_facts


def camera(told: int, *missing: int) -> CameraPlan:
    """A camera that has told of the first so many instants."""
    return CameraPlan(
        camera=CameraRecord(name="cam", facts=make_facts()),
        instants=tuple(sorted({*range(told)} - {*missing})),
        missing=tuple(
            MissingImage(camera="cam", instant=instant, reason="it dropped") for instant in missing
        ),
    )


def test_a_whole_burst_needs_no_spare_instant() -> None:
    assert choose_instants(8, 5, [camera(5), camera(5)]) == (0, 1, 2, 3, 4)


def test_what_any_camera_dropped_is_skipped_and_made_up_for() -> None:
    assert choose_instants(8, 3, [camera(5, 1), camera(5, 2), camera(5)]) == (0, 3, 4)


def test_nothing_is_chosen_before_it_is_known() -> None:
    assert choose_instants(8, 3, [camera(3), None]) is None
    assert choose_instants(8, 3, [camera(3, 1), camera(3)]) is None
    assert choose_instants(8, 3, [camera(3, 1), camera(4)]) is None
    assert choose_instants(8, 3, [camera(4, 1), camera(4)]) == (0, 2, 3)


def test_with_too_few_complete_instants_those_of_the_most_cameras_are_added() -> None:
    cameras = [camera(5, 0, 1, 2, 3), camera(5, 1), camera(5)]
    assert choose_instants(5, 3, cameras) == (0, 2, 4)


def test_a_camera_that_lacks_many_instants_costs_the_others_none() -> None:
    poor = camera(7, 2, 3, 4, 5, 6)
    assert choose_instants(7, 3, [camera(7, 0, 1), camera(7), poor]) == (2, 3, 4)


def test_without_any_camera_the_burst_is_as_it_was_ordered() -> None:
    assert choose_instants(8, 3, []) == (0, 1, 2)


shares = st.lists(st.sets(st.integers(0, 11)), min_size=1, max_size=5)


@given(shares, st.integers(1, 8), st.integers(0, 4))
def test_a_choice_never_changes_by_what_is_heard_later(
    missing: list[set[int]], frames: int, spare: int
) -> None:
    ordered = frames + spare
    whole = [camera(ordered, *(n for n in gone if n < ordered)) for gone in missing]
    final = choose_instants(ordered, frames, whole)
    assert final is not None
    assert len(final) == frames
    assert list(final) == sorted(set(final))
    for told in range(frames, ordered):
        part = [camera(told, *(n for n in gone if n < told)) for gone in missing]
        early = choose_instants(ordered, frames, part)
        assert early in (None, final)
    complete = [n for n in range(ordered) if all(n in one.instants for one in whole)]
    assert final == tuple(complete[:frames]) or len(complete) < frames
