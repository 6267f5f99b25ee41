"""`reconstruct live`: depth or people of a rig's previews; `capture-app` starts it, so it is hidden."""

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
import msgspec

from capture_app.common import system
from capture_app.common.errors import BadInputError, NotApplicableError, SimulshotError
from capture_app.common.plugins import load_plugin
from capture_app.common.text import UNREADABLE
from capture_app.session.format.live_pictures import (
    DEPTH,
    LENGTH,
    DepthPreview,
    InstantImages,
    LiveCameras,
    LivePicture,
    pack,
)

if TYPE_CHECKING:
    from reconstruction.common.geometry import Array, View

LOOK_S = 2.0
"""Interval between two searches for the rig's calibration."""
LATER_NICENESS = 9
"""Added to the process's niceness after the first picture: a rig's own work goes first."""
T = TypeVar("T")
Find = Callable[[InstantImages, Mapping[str, "Array"]], LivePicture]
"""Finds what is looked for in the images (BGR) of an instant; raises a SimulshotError if it cannot."""
Begin = Callable[[Mapping[str, "View"], str], Find]
"""Begins to look, by the calibrated views and their unit; an entry point of `simulshot.live`."""
FINDERS = "simulshot.live"
HINT = "simulated cameras: take once; others: reconstruct calibrate"


@click.command(hidden=True)
def live() -> None:
    """Read previews of one instant after the other from stdin, and write what is found in each to stdout."""
    import cv2

    from capture_app.session.reading.decoding import decode_preview
    from reconstruction.scene.calibration.stored import CameraMode, find_rig_views

    cv2.setNumThreads(1)
    messages = _messages()
    rig = _decode(next(messages, b""), LiveCameras)
    modes = {name: CameraMode.of(facts) for name, facts in rig.cameras.items()}
    folder = Path(rig.sessions_folder) if rig.sessions_folder else None
    begin: Begin = _depth if rig.subject == DEPTH else load_plugin(FINDERS, rig.subject)
    find: Find | None = None
    due_s, is_first = 0.0, True
    for data in messages:
        given = _decode(data, InstantImages)
        decoded = ((name, decode_preview(jpeg)) for name, jpeg in given.jpegs.items())
        images = {name: image for name, image in decoded if image is not None}
        try:
            if find is None and system.monotonic_s() >= due_s:
                due_s = system.monotonic_s() + LOOK_S
                views, unit = find_rig_views(modes, folder)
                find = begin(views, unit) if views else None
            if find is None:
                raise NotApplicableError("the rig is not calibrated", hint=HINT)
            answer = find(given, images)
            if is_first:
                system.lower_priority(LATER_NICENESS)
                is_first = False
        except SimulshotError as error:
            answer = LivePicture(given.instant_ns, given.camera, problem=str(error))
        sys.stdout.buffer.write(pack(answer))
        sys.stdout.buffer.flush()


def _depth(views: "Mapping[str, View]", _: str) -> Find:
    """Return what computes the depth of the chosen camera."""
    from capture_app.session.reading.decoding import encode_image
    from reconstruction.common.drawing import colour_depth
    from reconstruction.depth.live_depth import LiveDepth

    engine = LiveDepth(views)

    def find(given: InstantImages, images: "Mapping[str, Array]") -> DepthPreview:
        found = engine.compute(images, given.camera)
        jpeg = encode_image(colour_depth(found.depth, *found.depth_range))
        return DepthPreview(
            given.instant_ns, given.camera, jpeg=jpeg, moving_confirmed=found.moving_confirmed
        )

    return find


def _decode(data: bytes, kind: type[T]) -> T:
    try:
        return msgspec.msgpack.decode(data, type=kind)
    except UNREADABLE as error:
        raise BadInputError(
            "there are no previews of a rig on stdin",
            hint="the screen starts this command: run capture-app and choose live depth",
        ) from error


def _messages() -> Iterator[bytes]:
    """Yield the messages on stdin until it is closed."""
    stream = sys.stdin.buffer
    while len(prefix := stream.read(LENGTH.size)) == LENGTH.size:
        yield stream.read(*LENGTH.unpack(prefix))
