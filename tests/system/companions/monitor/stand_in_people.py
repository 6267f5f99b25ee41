"""Stands in for `reconstruct live`: two drawn figures move in front of any rig of any cameras."""

import sys

import numpy as np
from msgspec.msgpack import decode

from benchmarks.people.figure import moving, ring
from capture_app.session.format.live_pictures import LENGTH, InstantImages, LivePerson, PeoplePreview, pack
from reconstruction.methods.people.people_page import path_around
from reconstruction.methods.people.skeletons import SKELETONS

MOTIONS = {1: moving("walk"), 3: moving("throw", (0.3, 1.1), 2.0)}
JOINTS, BONES = SKELETONS["blazepose"]
ERRORS_M = np.linspace(0.02, 0.09, len(JOINTS))
VIEWS = {f"cam{number}": view for number, view in enumerate(ring(4, 120))}


def people_at(instant_ns: int) -> PeoplePreview:
    """The figures at a time."""
    at_s = np.array([instant_ns / 1e9 % 600])
    rows = {number: np.column_stack([motion(at_s)[0], ERRORS_M]) for number, motion in MOTIONS.items()}
    return PeoplePreview(
        instant_ns,
        "",
        people=tuple(
            LivePerson(number, {name: (*row,) for name, row in zip(JOINTS, own.tolist(), strict=True)})
            for number, own in rows.items()
        ),
        joints=JOINTS,
        bones=BONES,
        path=path_around(VIEWS, np.concatenate([*rows.values()])[:, :3]),
        unit="m",
    )


def main() -> None:
    stream = sys.stdin.buffer
    stream.read(*LENGTH.unpack(stream.read(LENGTH.size)))  # the cameras of the rig
    while len(prefix := stream.read(LENGTH.size)) == LENGTH.size:
        images = decode(stream.read(*LENGTH.unpack(prefix)), type=InstantImages)
        sys.stdout.buffer.write(pack(people_at(images.instant_ns)))
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
