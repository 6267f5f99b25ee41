"""Which instants a burst is to have: the first that are complete for all cameras."""

from collections.abc import Collection
from dataclasses import dataclass

FEWEST_SPARE = 4


def usual_spare(frames: int) -> int:
    """How many spare instants a burst gets: as many again, for a camera that loses every other frame."""
    return max(FEWEST_SPARE, frames)


@dataclass(frozen=True, slots=True)
class CameraInstants:
    """What a camera has told of the instants that were ordered, by their numbers."""

    there: frozenset[int]
    """Those of which it has a frame."""
    missing: frozenset[int]
    """Those of which it has none."""


def choose_instants(
    ordered: int, frames: int, cameras: Collection[CameraInstants | None]
) -> tuple[int, ...] | None:
    """Choose `frames` of the instants that were ordered; None where more must be heard first.

    `cameras` are those that are waited for, None for one that has told nothing yet. Where fewer instants are
    complete than are wanted, those of the most cameras are added, the earliest of equals.
    """
    told = [camera for camera in cameras if camera is not None]
    if len(told) < len(cameras):
        return None
    complete: list[int] = []
    undecided = False
    for instant in range(ordered):
        if len(complete) == frames:
            break
        if any(instant in camera.missing for camera in told):
            continue
        if all(instant in camera.there for camera in told):
            complete.append(instant)
        else:
            undecided = True
    if undecided:
        return None
    if len(complete) < frames:
        others = (instant for instant in range(ordered) if instant not in complete)
        by_cameras = sorted(others, key=lambda n: sum(n in camera.there for camera in told), reverse=True)
        complete += by_cameras[: frames - len(complete)]
    return tuple(sorted(complete))
