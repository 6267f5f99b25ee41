"""Points by COLMAP: the method."""

import msgspec

from reconstruction.compare.method import Method


class Triangulation(Method):
    """COLMAP's points on moving and still objects."""

    name = "triangulation"
    Options = msgspec.Struct
    study = f"{__package__}.triangulation_study:TriangulationStudy"
