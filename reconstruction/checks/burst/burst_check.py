"""Pictures of the burst: the check."""

from reconstruction.method.interface import Check


class PictureGrid(Check, frozen=True, kw_only=True):
    """The burst as a grid of small pictures."""

    name = "burst"
    study = f"{__package__}.burst_study:BurstStudy"
