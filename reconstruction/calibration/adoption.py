"""A session without a calibration takes that of its rig, if it still holds."""

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.terminal import talk
from reconstruction.calibration.consistency import RigCheck, check_rig
from reconstruction.calibration.kept import CalibrationShelf
from reconstruction.calibration.rig import calibrated_views, features_at_rest
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import SceneMotion


def check_calibration(dataset: Dataset, calibration: Calibration) -> RigCheck:
    """Hold a calibration against what stands still in the middle of a session.

    Raises:
        BadInputError: it is of other cameras, or of pictures of another shape.
    """
    views = calibrated_views(dataset, calibration)
    middle = len(dataset.instants_ns) // 2
    return check_rig(views, features_at_rest(SceneMotion(dataset, 1), views, middle))


def adopt_kept_calibration(dataset: Dataset) -> None:
    """Give a session that has no calibration the one kept of its rig, and say so; a camera that moved too.

    Recordings that were imported name no rig, and get none.
    """
    if dataset.calibration() is not None or dataset.session.manifest.origin == "imported":
        return
    kept = CalibrationShelf().find(dataset)
    if kept is None:
        return
    try:
        check = check_calibration(dataset, kept.calibration)
    except BadInputError as error:
        talk(f"the calibration kept from {kept.session} is not used: {error.what}")
        return
    if not check.holds:
        talk(
            f"the calibration kept from {kept.session} is not used: {check} "
            "(calibrate the rig again, as docs/calibration.md shows)"
        )
        return
    dataset.adopt_calibration(kept.with_origin)
    talk(f"calibration kept from {kept.session} of {kept.created[:10]}: {describe_check(check)}")


def describe_check(check: RigCheck) -> str:
    """What a check came to, in words."""
    if check.error_px is None:
        return "it cannot be checked, as the cameras share too little that stands still"
    text = f"{check} (points at rest fit within {check.error_px:.1f} px)"
    if check.unchecked:
        text += f"; not checked: {', '.join(check.unchecked)}"
    return text
