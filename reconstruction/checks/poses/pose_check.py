"""Camera poses of single instants: the check."""

from reconstruction.method.interface import Check


class PoseEstimation(Check, frozen=True, kw_only=True):
    """Camera poses of single instants, compared with the calibration."""

    name = "poses"
    study = f"{__package__}.pose_study:PoseStudy"
