"""Pictures of the burst: the method."""

import msgspec

from reconstruction.compare.method import Method


class PictureGrid(Method):
    """The burst as a grid of small pictures."""

    name = "burst"
    Options = msgspec.Struct
    study = f"{__package__}.burst_study:BurstStudy"
