"""Options of people in 3D: one struct for the command, and for the run that it starts."""

from typing import Annotated

from reconstruction.common.options import command_flag, flag
from reconstruction.method.interface import Method


class PeopleOptions(Method, frozen=True, kw_only=True):
    """Options of `PeopleMethod`."""

    # No option: a motion has many instants.
    instant: int = 0
    instants: Annotated[
        tuple[int, ...] | None,
        command_flag("--instants", metavar="all|K-L,M,...", help="Instants at which people are located."),
    ] = None
    """None or empty = all."""
    detector: Annotated[
        str, command_flag("--detector", metavar="NAME", help="Detector of joints in images.")
    ] = "blazepose"
    model: Annotated[
        str,
        command_flag(
            "--model",
            metavar="NAME",
            show_default="full",
            help="Model of the detector; BlazePose has lite, full and heavy.",
        ),
    ] = ""
    keypoints: Annotated[
        str | None,
        command_flag(
            "--keypoints",
            metavar="FOLDER",
            help="Use joints that another program found: OpenPose's, COCO's or MMPose's JSON, DeepLabCut's "
            "CSV or H5, SLEAP's analysis H5; a file or folder for each camera; or FreeMoCap's 2D array.",
        ),
        flag("--keypoints", metavar="FOLDER", help="Compare joints of people that another program found."),
    ] = None
    label_start: Annotated[
        str,
        command_flag(
            "--label-start",
            metavar="auto|N|session",
            help="Number that --keypoints gives to the first frame of the imported film or folder, such as "
            "0, 1 or 100. session: the session's own images were labelled, in their order.",
        ),
        flag("--label-start", metavar="auto|N|session", help="First frame's number in --keypoints."),
    ] = "auto"
    """`auto` = 0, or 1 where the last number shows it; what is open is refused."""
    rate: Annotated[
        float | None,
        command_flag(
            "--rate",
            gt=0,
            le=10_000,
            metavar="HZ",
            show_default="the session's instants",
            help="Locate people so many times a second, instead of at the instants.",
        ),
    ] = None
    nearest: Annotated[
        bool,
        command_flag("--nearest", help="Take the nearest frames as they are, for comparison."),
    ] = False
    smooth: Annotated[
        float | None,
        command_flag(
            "--smooth",
            gt=0,
            le=1000,
            metavar="HZ",
            help="Also write a low-pass filtered copy (Butterworth, no delay); gaps stay gaps.",
        ),
    ] = None
    up: Annotated[
        str,
        command_flag(
            "--up",
            metavar="auto|x|y|z|-x|-y|-z",
            help="Axis of the calibration that points up; auto = the one nearest to the cameras' own.",
        ),
    ] = "auto"
    film: Annotated[
        bool, command_flag("--film", help="Also write a film for each camera, with the joints drawn into it.")
    ] = False
    people: Annotated[bool, flag("--people", help="Compare the joints of people in 3D (longer).")] = False
