"""Points by COLMAP: the method."""

from reconstruction.method.interface import Check


class Triangulation(Check, frozen=True, kw_only=True):
    """COLMAP's points on moving and still objects."""

    name = "triangulation"
    study = f"{__package__}.triangulation_study:TriangulationStudy"
    needs = ("stereo",)
