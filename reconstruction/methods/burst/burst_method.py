"""Pictures of the burst: the method."""

from reconstruction.method.interface import Method


class PictureGrid(Method, frozen=True, kw_only=True):
    """The burst as a grid of small pictures."""

    name = "burst"
    study = f"{__package__}.burst_study:BurstStudy"
