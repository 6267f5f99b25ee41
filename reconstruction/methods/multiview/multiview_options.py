"""Options of depth from all cameras: one struct for the command, and for the runs that it starts."""

from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

from reconstruction.common.matchers import MATCHER_HELP, Matcher
from reconstruction.common.options import command_flag, flag
from reconstruction.method.interface import Method

if TYPE_CHECKING:
    from reconstruction.methods.multiview.matcher import ChosenMatcher


class MultiviewOptions(Method, frozen=True, kw_only=True, dict=True):
    """Options of `Multiview`."""

    instants: Annotated[
        tuple[int, ...] | None,
        command_flag(
            "--instants",
            metavar="all|K-L,M,...",
            help="Compute a cloud of each of these instants instead of one. A stopped run can be resumed.",
        ),
    ] = None
    """Instants of a sequence, empty = all; None = `instant` alone."""
    without: Annotated[
        tuple[str, ...], command_flag("--without", metavar="CAMERA,...", help="Leave these cameras out.")
    ] = ()
    width: Annotated[
        int | None,
        command_flag(
            "--width",
            ge=160,
            metavar="PX",
            show_default="as recorded",
            help="Reduce wider images to this width.",
        ),
    ] = None
    matcher: Annotated[
        Matcher, command_flag("--matcher", help=MATCHER_HELP), flag("--matcher", help=MATCHER_HELP)
    ] = Matcher.AUTO
    mesh: Annotated[
        bool | None,
        command_flag(
            "--mesh/--no-mesh",
            show_default="mesh; no mesh with --instants or --quick",
            help="Also compute a mesh and, for a single instant, a picture of it.",
        ),
    ] = None
    cloud: bool = True
    """Whether to clean the fused cloud, which needs Open3D."""
    workspace: bool = True
    """Whether to write the maps as a COLMAP workspace, which needs pycolmap."""
    min_evidence: float | None = None
    """Log odds of a right depth below which it is left out of moments, as splats take them."""
    check: bool = True
    """Whether to check the calibration by points at rest in the images."""
    quick: Annotated[
        bool, command_flag("--quick", help="Take half the time; thin parts and edges are less accurate.")
    ] = False
    """Start the sweep at half the size; do not score the cloud, and clean it only for a mesh."""
    page: Annotated[
        bool,
        command_flag("--page", help="Also write a page with an interactive 3D view of one instant's cloud."),
    ] = False
    calibrated: Annotated[
        bool, command_flag("--calibrated", help="Refuse to run without a valid calibration of the rig.")
    ] = False
    refine: Annotated[
        bool,
        command_flag(
            "--refine",
            help="First fit the cameras' poses to points at rest, by COLMAP's bundle adjustment. Use it if "
            "points at rest do not fit the calibration.",
        ),
    ] = False
    depth: Annotated[bool, command_flag("--depth", help="With --instants, also save the depth maps.")] = False
    whole: Annotated[
        bool,
        command_flag("--whole", help="With --instants, match the still scene again at every instant."),
    ] = False
    rrd: Annotated[bool, command_flag("--rrd", help="With --instants, also write a recording for Rerun.")] = (
        False
    )
    max_multiview_instants: Annotated[
        int,
        flag(
            "--max-multiview-instants",
            ge=0,
            metavar="N",
            help="Use at most this many instants for depth from all cameras, which takes much longer; 0 for "
            "none.",
        ),
    ] = 3
    multiview_width: Annotated[
        int,
        flag(
            "--multiview-width",
            ge=160,
            metavar="PX",
            help="Reduce wider images to this width for depth from all cameras.",
        ),
    ] = 640

    def __post_init__(self) -> None:
        """Refuse options that exclude each other, with ValueError."""
        super().__post_init__()
        if self.instants is not None and self.page:
            raise ValueError("--page shows one instant: leave out --instants")
        if self.instants is None and (self.depth or self.whole or self.rrd):
            raise ValueError("--depth, --whole and --rrd need --instants")

    @property
    def makes_mesh(self) -> bool:
        """Whether there is a mesh: as asked for, else of a single instant unless `quick`."""
        return self.instants is None and not self.quick if self.mesh is None else self.mesh

    @property
    def cleans_cloud(self) -> bool:
        """Whether the fused cloud is cleaned, with which a mesh begins."""
        return self.makes_mesh or (self.cloud and not self.quick and find_spec("open3d") is not None)

    @cached_property
    def chosen_matcher(self) -> "ChosenMatcher":
        """The matcher; raises NotAvailableError if this machine cannot run it."""
        from reconstruction.methods.multiview.matcher import choose_matcher

        return choose_matcher(self.matcher, quick=self.quick)
