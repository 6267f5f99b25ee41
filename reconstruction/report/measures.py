"""What the studies and their measures are called in a report: each is declared here, once."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.common.text import count
from reconstruction.report import wording
from reconstruction.scores.study_result import StudyResult

WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Vertical mismatch"
STILL_COVERAGE = "At rest: given a distance"
POINTS = "Points in space"


@dataclass(frozen=True)
class MeasureText:
    """A row of a table: the measure without its `mover_` or `static_`, its name, explanation and unit.

    `{near}`, `{number}` and `{tolerance}` in the explanation stand for what a study's facts say.
    """

    key: str
    name: str
    text: str
    unit: str = wording.SHARE


@dataclass(frozen=True)
class StudyText:
    """How a study is spoken of."""

    caption: str
    """The title of its table, in which `{names}`, `{cameras}` and `{reference}` stand."""
    term: str
    """What it is called among the entries on how it was made."""
    measures: Sequence[MeasureText]
    engine: str = ""
    """What found it, in a sentence."""
    missing: str = ""
    """What is said where it was skipped."""
    note: str = ""
    """What is said below its table."""
    control: bool = True
    """Whether its measures are taken on moving things and on the control."""

    def unit(self, measure: str) -> str:
        """The unit of a measure by its whole name."""
        return next(one.unit for one in self.measures if measure.endswith(one.key))


CORRECT = (
    MeasureText(
        "within_2pct",
        WITHIN,
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
    ),
    MeasureText("within_1pct", "The same, more strictly", "Within 1 % of the truth."),
    MeasureText("within_5pct", "The same, less strictly", "Within 5 % of the truth."),
)

STUDIES = {
    "multiview": StudyText(
        "Depth from {cameras}, as {reference} sees it",
        "All cameras",
        (
            *CORRECT,
            MeasureText(
                "coverage",
                COVERAGE,
                "Share for which at least three cameras agree on a distance. More is better.",
            ),
            MeasureText(
                "consistency",
                "Confirmed by other cameras",
                "Share whose distance two other cameras find independently, before other checks. More is "
                "better.",
            ),
            MeasureText(
                "photometric_error",
                "Brightness mismatch",
                "The other pictures are laid over this one by the distances found; this is how far the "
                "brightness differs, of 255. Less is better.",
                wording.PLAIN,
            ),
            MeasureText(
                "points",
                POINTS,
                "In the cloud fused from all cameras, the median over the instants.",
                wording.COUNT,
            ),
            MeasureText(
                "f_score",
                "Reconstructed surface",
                "How well the cloud and the true surface agree{near} (F-score): 100 % is the whole surface "
                "and nothing else. More is better.",
            ),
            MeasureText("precision", "Correct points", "Share of the points on a true surface{near}."),
            MeasureText("recall", "Surface covered", "Share of the true surface with a point{near}."),
        ),
        engine="Distances are found by {matcher}.",
    ),
    "stereo": StudyText(
        "Depth from cameras {names}",
        "Depth",
        (
            *CORRECT,
            MeasureText(
                "coverage",
                COVERAGE,
                "Share for which the two pictures agree on a distance; it may still be wrong. More is "
                "better.",
            ),
            MeasureText(
                "epipolar_px",
                EPIPOLAR,
                "A point should lie in the same row of both pictures; this is how far off it is. Less is "
                "better.",
                wording.PIXELS,
            ),
            MeasureText(
                "photometric_error",
                "Brightness mismatch",
                "One picture is laid over the other by the distances found; this is how far the brightness "
                "differs, of 255. Less is better.",
                wording.PLAIN,
            ),
        ),
        engine="Distances are found by OpenCV's semi-global block matching (SGBM).",
        missing="Depth was not measured",
    ),
    "triangulation": StudyText(
        "Points by COLMAP from {cameras}",
        "Points by COLMAP",
        (
            MeasureText("points", POINTS, "Found and placed at an instant. More is better.", wording.COUNT),
            MeasureText(
                "reprojection_px",
                "Reprojection error",
                "How far a placed point is from where the cameras see it. Less is better.",
                wording.PIXELS,
            ),
            MeasureText(
                "precision",
                "Correct points",
                "Share of the points whose distance is within 2 % of the truth.",
            ),
        ),
        missing="No points were placed by COLMAP",
        note="COLMAP, a program for reconstruction from photographs, looks for single points that several "
        "pictures show and works out where each of them is: what has moved between the pictures seldom fits "
        "together, so most of its points are lost, and those that fit by chance are in the wrong place.",
    ),
    "panorama": StudyText(
        "Panorama of cameras {names}",
        "Panorama",
        (
            MeasureText(
                "misfit_px",
                "Misfit",
                "How far apart the two pictures show the same point, without a seam; the median. Less is "
                "better.",
                wording.PIXELS,
            ),
            MeasureText(
                "found",
                "Found again",
                "Share of the points with structure that the other picture shows within reach. More is "
                "better.",
            ),
            MeasureText(
                "points", "Points measured", "How many points of an instant were found again.", wording.COUNT
            ),
            MeasureText(
                "overlap_mad", "Brightness difference", "On average, of 255. Less is better.", wording.PLAIN
            ),
        ),
        engine="The panorama is put together by OpenCV.",
        missing="No panorama was made",
    ),
    "poses": StudyText(
        "Poses of {cameras}, each instant by itself",
        "Poses by instant",
        (
            MeasureText(
                "registered",
                "Cameras placed",
                "Of {number}, the median over the instants. More is better.",
                wording.PLAIN,
            ),
            MeasureText(
                "correct_pairs",
                "Camera pairs placed correctly",
                "Share of all pairs whose angle and direction are correct within {tolerance}. More is "
                "better.",
            ),
            MeasureText(
                "rotation_deg",
                "Angle error",
                "Of the angle between two placed cameras, the median over the pairs. Less is better.",
                wording.DEGREES,
            ),
            MeasureText(
                "direction_deg",
                "Direction error",
                "Of the direction from one camera to the other, the median over the pairs. Less is better.",
                wording.DEGREES,
            ),
        ),
        control=False,
    ),
}


def describe_facts(study: StudyResult) -> dict[str, str]:
    """What stands for the names in braces: of the study's cameras and facts."""
    patchmatch = study.facts.get("matcher") == "patchmatch"
    tolerance_m = study.facts.get("tolerance_m")
    return {
        "names": " and ".join(study.cameras),
        "cameras": count(len(study.cameras), "camera"),
        "number": f"{len(study.cameras)}",
        "reference": study.facts.get("reference", ""),
        "near": "" if tolerance_m is None else f" to within {100 * tolerance_m:.3g}{wording.GAP}cm",
        "matcher": "COLMAP's PatchMatch on a GPU" if patchmatch else "our own plane sweep, not by COLMAP",
        "tolerance": wording.measured(study.facts.get("tolerance_deg"), wording.DEGREES),
    }
