"""Names and explanations of the measures in a report's tables."""

from collections.abc import Callable
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.scores.study_result import MultiviewComparison, PoseComparison

WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Vertical mismatch"
STILL_COVERAGE = "At rest: given a distance"
POINTS = "Points in space"


def pixels(value: float | None) -> str:
    """A length in px."""
    return wording.quantity(value, "px")


def degrees(value: float | None) -> str:
    """An angle in degrees with two or three digits."""
    if value is None:
        return wording.NOT_AVAILABLE
    return f"{value:.3g}°" if value >= 1 else f"{value:.2g}°"


@dataclass(frozen=True)
class Measure:
    """A row of a table: the field of the scores that it shows, its name and its explanation.

    `show` writes a value; shares (`wording.share`) also get a bar.
    """

    key: str
    name: str
    text: str
    show: Callable[[float | None], str] = wording.share


CORRECT = (
    Measure(
        "within_2pct",
        WITHIN,
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
    ),
    Measure("within_1pct", "The same, more strictly", "Within 1 % of the truth."),
    Measure("within_5pct", "The same, less strictly", "Within 5 % of the truth."),
)

DEPTH = (
    *CORRECT,
    Measure(
        "coverage",
        COVERAGE,
        "Share for which the two pictures agree on a distance; it may still be wrong. More is better.",
    ),
    Measure(
        "epipolar_px",
        EPIPOLAR,
        "A point should lie in the same row of both pictures; this is how far off it is. Less is better.",
        pixels,
    ),
    Measure(
        "photometric_error",
        "Brightness mismatch",
        "One picture is laid over the other by the distances found; this is how far the brightness differs, "
        "of 255. Less is better.",
        wording.quantity,
    ),
)

PANORAMA = (
    Measure(
        "misfit_px",
        "Misfit",
        "How far apart the two pictures show the same point, without a seam; the median. Less is better.",
        pixels,
    ),
    Measure(
        "found",
        "Found again",
        "Share of the points with structure that the other picture shows within reach. More is better.",
    ),
    Measure("points", "Points measured", "How many points of an instant were found again.", wording.number),
    Measure("overlap_mad", "Brightness difference", "On average, of 255. Less is better.", wording.quantity),
)


TRIANGULATION = (
    Measure("points", POINTS, "Found and placed at an instant. More is better.", wording.number),
    Measure(
        "reprojection_px",
        "Reprojection error",
        "How far a placed point is from where the cameras see it. Less is better.",
        pixels,
    ),
    Measure("precision", "Correct points", "Share of the points whose distance is within 2 % of the truth."),
)


def multiview_measures(result: MultiviewComparison) -> tuple[Measure, ...]:
    """The rows of depth from all cameras."""
    near = "" if result.tolerance_m is None else f" to within {100 * result.tolerance_m:.3g}{wording.GAP}cm"
    return (
        *CORRECT,
        Measure(
            "coverage",
            COVERAGE,
            "Share for which at least three cameras agree on a distance. More is better.",
        ),
        Measure(
            "consistency",
            "Confirmed by other cameras",
            "Share whose distance two other cameras find independently, before other checks. More is better.",
        ),
        Measure(
            "epipolar_px",
            EPIPOLAR,
            "How far the same point in another camera is off its epipolar line. Less is better.",
            pixels,
        ),
        Measure(
            "photometric_error",
            "Brightness mismatch",
            "The other pictures are laid over this one by the distances found; this is how far the "
            "brightness differs, of 255. Less is better.",
            wording.quantity,
        ),
        Measure(
            "points",
            POINTS,
            "In the cloud fused from all cameras, the median over the instants.",
            wording.number,
        ),
        Measure(
            "f_score",
            "Reconstructed surface",
            f"How well the cloud and the true surface agree{near} (F-score): 100 % is the whole surface and "
            "nothing else. More is better.",
        ),
        Measure("precision", "Correct points", f"Share of the points on a true surface{near}."),
        Measure("recall", "Surface covered", f"Share of the true surface with a point{near}."),
    )


def pose_measures(result: PoseComparison) -> tuple[Measure, ...]:
    """The rows of poses estimated from single instants."""
    return (
        Measure(
            "registered",
            "Cameras placed",
            f"Of {len(result.cameras)}, the median over the instants. More is better.",
            wording.quantity,
        ),
        Measure(
            "correct_pairs",
            "Camera pairs placed correctly",
            "Share of all pairs whose angle and direction are correct within "
            f"{degrees(result.tolerance_deg)}. More is better.",
        ),
        Measure(
            "rotation_deg",
            "Angle error",
            "Of the angle between two placed cameras, the median over the pairs. Less is better.",
            degrees,
        ),
        Measure(
            "direction_deg",
            "Direction error",
            "Of the direction from one camera to the other, the median over the pairs. Less is better.",
            degrees,
        ),
    )
