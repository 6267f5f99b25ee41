"""Broken and odd calibrations, each by what it does to a sound session."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.unit.reconstruction.commands.odd_session import OddSession

Change = Callable[[OddSession], None]
NAN, INFINITE = float("nan"), float("inf")
FLIPPED = np.diag([1.0, 1.0, -1.0])


def both(*changes: Change) -> Change:
    """One change after the other."""

    def change(session: OddSession) -> None:
        for one in changes:
            one(session)

    return change


def _focal(value: Any, *cameras: str) -> Change:
    """Give both focal lengths of some cameras, or of all, another value."""
    return both(_set("fx", value, *cameras), _set("fy", value, *cameras))


def _set(field: str, value: Any, *cameras: str) -> Change:
    """Give a field of some cameras' calibrations, or of all, another value."""

    def change(session: OddSession) -> None:
        for name in cameras or session.calibration["cameras"]:
            session.camera(name)[field] = value

    return change


def _poses(rotation: Any, place: Any, *cameras: str) -> Change:
    """Turn cameras: `rotation` (3x3) is multiplied on, `place` (3,) is where they stand then; None: stay."""

    def change(session: OddSession) -> None:
        for name in cameras or session.calibration["cameras"]:
            camera = session.camera(name)
            old = np.array(camera["rotation"])
            centre = -old.T @ np.array(camera["translation"]) if place is None else np.array(place, float)
            new = np.array(rotation, float) @ old
            camera["rotation"], camera["translation"] = new.tolist(), (-new @ centre).tolist()

    return change


def _same_pose(shift: float, *cameras: str) -> Change:
    """Give cameras the pose of the first, but for a shift to the right."""

    def change(session: OddSession) -> None:
        first, *others = cameras or session.calibration["cameras"]
        for name in others:
            pose = session.camera(first)
            session.camera(name)["rotation"] = pose["rotation"]
            session.camera(name)["translation"] = [pose["translation"][0] - shift, *pose["translation"][1:]]

    return change


def _scaled(factor: float) -> Change:
    """Multiply all translations."""

    def change(session: OddSession) -> None:
        for camera in session.calibration["cameras"].values():
            camera["translation"] = [value * factor for value in camera["translation"]]

    return change


def _exchanged(a: str, b: str) -> Change:
    """Give two cameras each other's calibration."""

    def change(session: OddSession) -> None:
        cameras = session.calibration["cameras"]
        cameras[a], cameras[b] = cameras[b], cameras[a]

    return change


def _file(data: bytes) -> Change:
    """Replace the file."""

    def change(session: OddSession) -> None:
        session.calibration = data

    return change


def _whole(how: Callable[[dict[str, Any]], Any]) -> Change:
    """Change the file's data."""

    def change(session: OddSession) -> None:
        how(session.calibration)

    return change


def turn(axis: int, degrees: float) -> Any:
    """The rotation about an axis of the camera."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    found = np.eye(3)
    a, b = [i for i in range(3) if i != axis]
    found[a, a], found[a, b], found[b, a], found[b, b] = c, -s, s, c
    return found


CALIBRATIONS: dict[str, Change] = {
    "equal poses, all": _same_pose(0.0),
    "equal poses, two": _same_pose(0.0, "left", "middle"),
    "nearly equal poses, all": _same_pose(1e-12),
    "nearly equal poses, two": _same_pose(1e-9, "left", "right"),
    "poses a micron apart": _same_pose(1e-6),
    "poses a tenth of a millimetre apart": _same_pose(1e-4),
    "poses a kilometre apart": _same_pose(1e3),
    "two exchanged": _exchanged("left", "right"),
    "one place, turned": _poses(np.eye(3), (0, 0, 0)),
    "behind each other": _poses(np.eye(3), (0, 0, -1.0), "right"),
    "behind each other, both": both(
        *(_poses(np.eye(3), (0, 0, at), name) for at, name in ((-1, "left"), (0, "middle"), (1, "right")))
    ),
    "a little ahead": _poses(np.eye(3), (0.01, 0, 0.5), "left"),
    "facing each other": _poses(turn(1, 180), (0, 0, 6.0), "right"),
    "back to back": _poses(turn(1, 180), None, "left"),
    "all look away": _poses(turn(1, 180), None),
    "one looks up": _poses(turn(0, 90), None, "middle"),
    "one is upside down": _poses(turn(2, 180), None, "right"),
    "all are upside down": _poses(turn(2, 180), None),
    "one lies on its side": _poses(turn(2, 90), None, "left"),
    "cross-eyed by 60 degrees": both(
        _poses(turn(1, 60), None, "left"), _poses(turn(1, -60), None, "right")
    ),
    "wall-eyed by 80 degrees": both(
        _poses(turn(1, -80), None, "left"), _poses(turn(1, 80), None, "right")
    ),
    "turned by 5 degrees": _poses(turn(1, 5), None, "right"),
    "mirrored, one": _poses(FLIPPED, None, "left"),
    "mirrored, all": _poses(FLIPPED, None),
    "mirrored sideways": _poses(np.diag([-1.0, 1, 1]), None),
    "inside out": _poses(-np.eye(3), None),
    "no rotation": _set("rotation", np.zeros((3, 3)).tolist()),
    "no rotation, one": _set("rotation", np.zeros((3, 3)).tolist(), "right"),
    "rotation of ones": _set("rotation", np.ones((3, 3)).tolist(), "left"),
    "rotation twice as long": _poses(2 * np.eye(3), None),
    "rotation a thousandth": _poses(1e-3 * np.eye(3), None, "middle"),
    "rotation sheared": _poses([[1, 0.3, 0], [0, 1, 0], [0, 0, 1]], None, "left"),
    "rotation of 1e9": _set("rotation", np.full((3, 3), 1e9).tolist()),
    "rotation NaN": _set("rotation", [[NAN] * 3] * 3, "left"),
    "rotation of 2 x 3": _set("rotation", [[1, 0, 0], [0, 1, 0]]),
    "rotation in words": _set("rotation", "none", "right"),
    "rotation null": _set("rotation", None),
    "translation NaN": _set("translation", [NAN, 0, 0], "left"),
    "translation infinite": _set("translation", [INFINITE, 0, 0]),
    "translation 1e9": _set("translation", [1e9, 0, 0], "right"),
    "translation 1e9, all": _set("translation", [1e9, 1e9, 1e9]),
    "translation 1e150": _set("translation", [1e150, 0, 0], "left"),
    "translation 1e308": _set("translation", [1e308, -1e308, 1e308], "left"),
    "translation 1e-300": _set("translation", [1e-300, 0, 0]),
    "translation of two numbers": _set("translation", [0, 0]),
    "translation null": _set("translation", None, "middle"),
    "all a million times as far": _scaled(1e6),
    "all 1e9 times as far": _scaled(1e9),
    "all a thousandth": _scaled(1e-3),
    "all 1e-9 as far": _scaled(1e-9),
    "no focal length": _set("fx", 0.0),
    "no focal length, one": _set("fy", 0.0, "left"),
    "focal length negative": _set("fx", -300.0),
    "focal lengths negative, one": _focal(-300.0, "right"),
    "focal length 1e-9": _focal(1e-9),
    "focal length 1 px": _focal(1.0),
    "focal length 20 px, one": _focal(20.0, "right"),
    "focal length 3000 px": _focal(3000.0),
    "focal length 1e5": _focal(1e5),
    "focal length 1e9": _focal(1e9),
    "focal length 1e300, one": _set("fx", 1e300, "middle"),
    "focal length NaN": _set("fx", NAN),
    "focal length infinite": _set("fx", INFINITE, "left"),
    "focal length in words": _set("fx", "300"),
    "focal length null": _set("fy", None),
    "focal lengths 100 : 1": _set("fy", 3.0),
    "centre 1e9": _set("cx", 1e9),
    "centre -1e9": _set("cy", -1e9, "left"),
    "centre far outside": _set("cx", 5000.0, "right"),
    "centre in the corner": both(_set("cx", 0.0), _set("cy", 0.0)),
    "centre NaN": _set("cx", NAN, "right"),
    "distortion 1e9": _set("distortion", [1e9, 0, 0, 0, 0]),
    "distortion 100": _set("distortion", [100.0, 0, 0, 0, 0], "left"),
    "distortion -5": _set("distortion", [-5.0, 0, 0, 0, 0]),
    "distortion -1": _set("distortion", [-1.0, 0, 0, 0, 0], "right"),
    "distortion folds": _set("distortion", [0.5, -8.0, 0, 0, 0]),
    "distortion tangential 10": _set("distortion", [0, 0, 10.0, -10.0, 0]),
    "distortion k3 1e6": _set("distortion", [0, 0, 0, 0, 1e6], "middle"),
    "distortion NaN": _set("distortion", [NAN] * 5),
    "distortion 1e308": _set("distortion", [1e308] * 5, "left"),
    "distortion empty": _set("distortion", []),
    "distortion of 1 number": _set("distortion", [-0.1]),
    "distortion of 8 numbers": _set("distortion", [0.1] * 8),
    "distortion of 14 numbers": _set("distortion", [0.0] * 14),
    "distortion in words": _set("distortion", "much"),
    "width 0": _set("width", 0),
    "height 0, one": _set("height", 0, "left"),
    "width -320": _set("width", -320),
    "size 1x1": both(_set("width", 1), _set("height", 1)),
    "size 1e9": both(_set("width", 10**9), _set("height", 10**9)),
    "size turned": both(_set("width", 240, "left"), _set("height", 320, "left")),
    "size doubled": both(_set("width", 640), _set("height", 480)),
    "width 319.5": _set("width", 319.5),
    "no cameras": _whole(lambda c: c["cameras"].clear()),
    "one camera": _whole(lambda c: [c["cameras"].pop(name) for name in ("left", "right")]),
    "one camera lacks": _whole(lambda c: c["cameras"].pop("middle")),
    "another rig's": _whole(lambda c: c.update(cameras={"x": c["cameras"]["left"]})),
    "one more camera": _whole(lambda c: c["cameras"].update(more=c["cameras"]["left"])),
    "cameras as a list": _whole(lambda c: c.update(cameras=list(c["cameras"].values()))),
    "unit empty": _whole(lambda c: c.update(unit="")),
    "unit parsec": _whole(lambda c: c.update(unit="parsec")),
    "unit a number": _whole(lambda c: c.update(unit=3)),
    "schema version 99": _whole(lambda c: c.update(schema_version=99)),
    "unknown field": _whole(lambda c: c.update(colour="blue")),
    "field lacks": _whole(lambda c: c["cameras"]["left"].pop("fx")),
    "empty file": _file(b""),
    "cut file": _file(b'{"cameras": {"left": {"width": 320, "hei'),
    "a list": _file(b"[]"),
    "a number": _file(b"7"),
    "null": _file(b"null"),
    "binary": _file(bytes(range(256))),
    "deeply nested": _file(b"[" * 20_000 + b"]" * 20_000),
    "two values": _file(b"{} {}"),
    "a long source": _whole(lambda c: c.update(source="x\x1b[2J\n" * 2000)),
}  # fmt: skip
