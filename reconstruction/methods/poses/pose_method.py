"""Camera poses of single instants: the method and its options."""

from typing import Annotated

import msgspec

from reconstruction.common.options import flag
from reconstruction.compare.method import Method


class PoseOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of camera poses in a comparison."""

    poses: Annotated[
        bool | None,
        flag(
            "--poses/--no-poses",
            show_default="if much of the picture moves",
            help="Also estimate the camera poses from single instants.",
        ),
    ] = None


class PoseEstimation(Method):
    """Camera poses of single instants, compared with the calibration."""

    name = "poses"
    Options = PoseOptions
    study = f"{__package__}.pose_study:PoseStudy"
