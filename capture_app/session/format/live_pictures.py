"""Messages to and from `reconstruct live`, which looks at previews of one instant while a rig runs.

Each has its length in front: on stdin first a `LiveCameras`, then `InstantImages`, each answered on stdout by
a `DepthPreview` or a `PeoplePreview` before the next is sent.
"""

import struct
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import msgspec
from msgspec import Struct

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.text import count, duration

DEPTH, PEOPLE = "depth", "people"
WIDTHS_PX = {DEPTH: 320, PEOPLE: 640}
"""What is looked for, and the width of the previews that this takes."""
LENGTH = struct.Struct(">I")


class LiveCameras(Struct, frozen=True):
    """Cameras of a rig, the folder of its sessions, which may be calibrated, and what is looked for."""

    cameras: dict[str, CameraFacts]
    sessions_folder: str
    subject: str = DEPTH


class InstantImages(Struct, frozen=True):
    """JPEGs of cameras at one instant (leader time, ns), and the camera whose picture is requested."""

    instant_ns: int
    camera: str
    jpegs: dict[str, bytes]


class LivePicture(Struct, frozen=True):
    """What was found at one instant, as a JPEG of the chosen camera, empty if there is none."""

    instant_ns: int
    camera: str
    jpeg: bytes = b""
    problem: str = ""
    """Reason why nothing was found, and a remedy."""
    late_ns: int | None = None
    """Age of the instant at receipt, added by the receiver; None if the leader's time is unknown."""
    absent: dict[str, str] = {}
    """Cameras that gave no picture of this instant, and why; added by the receiver."""

    def rate_and_delay(self, times_s: Sequence[float]) -> list[str]:
        """Return, in words, pictures a second by the times (s) of the latest ones, and how late this is."""
        if len(times_s) < 2:
            return []
        rate = (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-3)
        return [f"{rate:.1f} a second, {duration(self.late_ns)} late"]


class DepthPreview(LivePicture, frozen=True):
    """Depth of a camera at one instant, coloured; near is bright."""

    moving_confirmed: float | None = None
    """Fraction of moving pixels whose depth the other cameras confirm; None if few pixels move."""


class LivePerson(Struct, frozen=True):
    """A person at one instant: x, y, z and error of each joint that two cameras agree on, by its name.

    The error is the radius that should hold the true position in 95 % of cases; all are in the calibration's
    axes and unit.
    """

    number: int
    """From 1; the same as long as the person is followed, and then free for another."""
    joints: dict[str, tuple[float, float, float, float]]


class PeoplePreview(LivePicture, frozen=True):
    """People of one instant, and a camera's picture with their joints drawn into it."""

    people: tuple[LivePerson, ...] = ()
    joints: tuple[str, ...] = ()
    """Names of all joints of the skeleton."""
    bones: tuple[tuple[int, int], ...] = ()
    """Pairs of joints, by their numbers in `joints`, that a bone joins."""
    path: dict[str, Any] = {}
    """Places from which a page looks at them, as `path` of a page to walk round in; empty without people."""
    unit: str = ""
    """Unit of length of the calibration, such as m; empty if it has none."""

    @property
    def counted(self) -> str:
        """How many people there are, in words: 1 person, 2 people."""
        return "1 person" if len(self.people) == 1 else f"{len(self.people)} people"

    def described(self, times_s: Sequence[float], titles: Mapping[str, str]) -> str:
        """Return the instant as a line; `times_s` says when the latest ones came, `titles` names cameras."""
        if self.problem:
            return self.problem
        words = [self.counted]
        errors = [row[3] for person in self.people for row in person.joints.values()]
        if errors:
            words.append(
                f"{count(len(errors), 'joint')}, 95 % error {median(errors):.3g} {self.unit}".strip()
            )
        words += self.rate_and_delay(times_s)
        words += [f"without {titles.get(name, name)}: {why}" for name, why in sorted(self.absent.items())]
        return "; ".join(words)


def pack(message: Struct) -> bytes:
    """Return a message with its length in front."""
    data = msgspec.msgpack.encode(message)
    return LENGTH.pack(len(data)) + data
