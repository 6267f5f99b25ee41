"""`reconstruct live`: depth of a running rig's previews; `capture-app` starts it, so it is hidden."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import click
import msgspec

from capture_app.common import system
from capture_app.common.errors import BadInputError, NotApplicableError, SimulshotError
from capture_app.common.text import UNREADABLE
from capture_app.session.format.live_depth import (
    LENGTH,
    WIDTH_PX,
    DepthPreview,
    InstantImages,
    LiveCameras,
    pack,
)

LOOK_S = 2.0
"""Interval between two searches for the rig's calibration."""
LATER_NICENESS = 9
"""Added to the process's niceness after the first depth: a rig's own work goes first."""
T = TypeVar("T")
HINT = "simulated cameras: take once; others: reconstruct calibrate"


@click.command(hidden=True)
def live() -> None:
    """Read previews of one instant after the other from stdin, and write the depth of each to stdout."""
    import cv2

    from capture_app.session.reading.decoding import decode_preview, encode_image
    from reconstruction.common.drawing import colour_depth
    from reconstruction.depth.live_depth import LiveDepth
    from reconstruction.scene.calibration.stored import CameraMode, find_rig_views

    cv2.setNumThreads(1)
    messages = _messages()
    rig = _decode(next(messages, b""), LiveCameras)
    modes = {name: CameraMode.of(facts) for name, facts in rig.cameras.items()}
    folder = Path(rig.sessions_folder) if rig.sessions_folder else None
    engine, due_s, is_first = None, 0.0, True
    for data in messages:
        given = _decode(data, InstantImages)
        decoded = ((name, decode_preview(jpeg)) for name, jpeg in given.jpegs.items())
        images = {name: image for name, image in decoded if image is not None}
        answer = DepthPreview(given.instant_ns, given.camera)
        if engine is None and system.monotonic_s() >= due_s:
            due_s = system.monotonic_s() + LOOK_S
            views = find_rig_views(modes, folder)
            engine = LiveDepth(views, WIDTH_PX) if views else None
        try:
            if engine is None:
                raise NotApplicableError("the rig is not calibrated", hint=HINT)
            depth = engine.compute(images, given.camera)
            jpeg = encode_image(colour_depth(depth.depth, *depth.depth_range))
            answer = msgspec.structs.replace(answer, jpeg=jpeg, moving_confirmed=depth.moving_confirmed)
            if is_first:
                system.lower_priority(LATER_NICENESS)
                is_first = False
        except SimulshotError as error:
            answer = msgspec.structs.replace(answer, problem=str(error))
        sys.stdout.buffer.write(pack(answer))
        sys.stdout.buffer.flush()


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
