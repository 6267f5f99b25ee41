"""Camera poses of single instants: the check and its options."""

from typing import Annotated

from reconstruction.common.options import flag
from reconstruction.method.interface import Check


class PoseEstimation(Check, frozen=True, kw_only=True):
    """Camera poses of single instants, compared with the calibration."""

    name = "poses"
    study = f"{__package__}.pose_study:PoseStudy"

    poses: Annotated[
        bool | None,
        flag(
            "--poses/--no-poses",
            show_default="if much of the picture moves",
            help="Also estimate the camera poses from single instants.",
        ),
    ] = None
