"""Options of splats: one struct for the command, and for the run that it starts."""

from typing import Annotated

from reconstruction.common.options import Masks, command_flag, flag
from reconstruction.method.interface import Method


class SplatOptions(Method, frozen=True, kw_only=True):
    """Options of `SplatMethod`."""

    instants: Annotated[
        tuple[int, ...] | None,
        command_flag(
            "--instants",
            metavar="all|K-L,M,...",
            help="Make a splat of each of these instants instead of one.",
        ),
    ] = None
    """Instants in order, empty = all; None = `instant` alone."""
    without: Annotated[
        tuple[str, ...], command_flag("--without", metavar="CAMERA,...", help="Leave these cameras out.")
    ] = ()
    masks: Masks = None
    iterations: Annotated[
        int,
        command_flag(
            "--iterations",
            ge=0,
            le=10_000,
            metavar="N",
            help="How often each camera's picture is compared. 2 for a quick look.",
        ),
    ] = 10
    all_cameras: Annotated[
        bool,
        command_flag(
            "--all-cameras",
            help="Use all cameras. By default, the middle one of four or more is left out, and its picture "
            "judges the splat.",
        ),
    ] = False
    width: Annotated[
        int,
        command_flag(
            "--width",
            ge=160,
            metavar="PX",
            help="Reduce larger pictures to this length of their longer side.",
        ),
    ] = 960
    quick: Annotated[
        bool,
        command_flag("--quick", help="Take half the time for depth; thin parts and edges are less accurate."),
    ] = False

    page: Annotated[
        bool, command_flag("--page", help="Also write splat.html, a page that plays the splats.")
    ] = False
    spz: Annotated[
        bool, command_flag("--spz", help="Also write each splat as .spz, a fifth of the .ply's size.")
    ] = False
    splats: Annotated[
        bool,
        flag(
            "--splats",
            help="Also make a splat of one instant without one of four or more cameras, and compare it with "
            "that camera's picture. Takes about half a minute.",
        ),
    ] = False
