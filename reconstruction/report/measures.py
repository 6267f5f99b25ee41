"""What the measures of a report are called and how they are to be read; the same in every table."""

from collections.abc import Callable
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.scores.depth_results import MultiviewComparison
from reconstruction.scores.pose_results import PoseComparison

WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Up-and-down mismatch"
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
    """A row of a table: the field of the scores that it shows, its name and how it is to be read.

    `show` writes a value; shares (`wording.share`) also get a bar.
    """

    key: str
    name: str
    text: str
    show: Callable[[float | None], str] = wording.share
    control: bool = False


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
        "mover_flow_p95_px",
        "Misfit of moving things",
        "How far apart both pictures show the same thing; 5 % of what moves is worse. Less is better.",
        pixels,
    ),
    Measure(
        "overlap_flow_p95_px",
        "Misfit in the whole overlap",
        "The same, for everything where the pictures overlap.",
        pixels,
    ),
    Measure(
        "mover_overlap_mad",
        "Brightness difference of moving things",
        "On average, of 255. Less is better.",
        wording.quantity,
    ),
    Measure(
        "static_overlap_mad",
        "Brightness difference of things at rest (control)",
        "On average, of 255; it should not depend on timing.",
        wording.quantity,
        control=True,
    ),
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
            "Found by others too",
            "Share whose distance two other cameras find, each for itself, before any other check. More is "
            "better.",
        ),
        Measure(
            "epipolar_px",
            EPIPOLAR,
            "How far what two cameras show of one point is off its line. Less is better.",
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
            "In the cloud fused from all cameras, of one instant on average.",
            wording.number,
        ),
        Measure(
            "f_score",
            "Surface rebuilt",
            f"How well the cloud and the true surface agree{near}: 100 % is all of it and nothing else "
            "(F-score). More is better.",
        ),
        Measure("precision", "Points that are right", f"Share of the points on a true surface{near}."),
        Measure("recall", "Surface with points", f"Share of the true surface that has a point{near}."),
    )


def pose_measures(result: PoseComparison) -> tuple[Measure, ...]:
    """The rows of poses found from single instants."""
    return (
        Measure(
            "registered",
            "Cameras placed",
            f"Of {len(result.cameras)}, at an instant on average. More is better.",
            wording.quantity,
        ),
        Measure(
            "correct_pairs",
            "Pairs placed right",
            "Share of all pairs of cameras whose angle and direction are right to "
            f"{degrees(result.tolerance_deg)}. More is better.",
        ),
        Measure(
            "rotation_deg",
            "Wrong by, angle",
            "Of the angle between two cameras that were placed; half of the pairs are worse. Less is better.",
            degrees,
        ),
        Measure(
            "direction_deg",
            "Wrong by, direction",
            "Of the direction from one camera to the other, likewise.",
            degrees,
        ),
    )
