"""Options of views along a path: one struct for the command, and for the run that it starts."""

from typing import Annotated

from capture_app.session.format.calibration import CameraCalibration
from reconstruction.common.options import Masks, command_flag
from reconstruction.method.interface import Method


class ViewOptions(Method, frozen=True, kw_only=True):
    """Options of `ViewMethod`."""

    path: Annotated[
        str | tuple[CameraCalibration, ...],
        command_flag(
            "--path",
            metavar="swing|orbit|still|FILE",
            help="Path of the camera: from one end of the rig to the other and back, on an ellipse, still in "
            "the middle with one picture of each moment, or the cameras of a file (calibration.json, or "
            "nerfstudio's camera path) in their order.",
        ),
    ] = "swing"
    """`swing`, `orbit`, `still`, a file, or cameras."""
    frames: Annotated[
        int, command_flag("--frames", ge=2, le=10_000, metavar="N", help="Pictures of swing and orbit.")
    ] = 90
    fps: Annotated[
        float | None,
        command_flag(
            "--fps",
            gt=0,
            le=240,
            metavar="FPS",
            show_default="30; as recorded with --path still",
            help="Pictures a second of the film.",
        ),
    ] = None
    instants: Annotated[
        tuple[int, ...] | None,
        command_flag(
            "--instants",
            metavar="all|K-L,M,...",
            help="Let time pass over these instants along the path, instead of standing still.",
        ),
    ] = None
    """Instants in order, empty = all; None = `instant` alone."""
    masks: Masks = None
    quick: Annotated[
        bool, command_flag("--quick", help="Take half the time; thin parts and edges are less accurate.")
    ] = False

    page: Annotated[
        bool, command_flag("--page", help="Also write view.html, a page to walk round in; --out is a folder.")
    ] = False
