"""The views of a session's cameras whose calibration the judge accepts."""

from collections.abc import Container, Sequence

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.calibration_judge import Fault, camera_fault, rig_faults
from reconstruction.common.geometry import View
from reconstruction.scene.dataset import Dataset


def calibrated_views(dataset: Dataset, calibration: Calibration) -> dict[str, View]:
    """Return the views of the session's plausibly calibrated cameras, at the size of their images.

    Raises:
        BadInputError: the calibration is of other cameras, or faults leave fewer than two views.
    """
    views, faults = sound_views(dataset, calibration)
    refuse_faults(dataset, views, faults)
    return views


def sound_views(dataset: Dataset, calibration: Calibration) -> tuple[dict[str, View], list[Fault]]:
    """Return the cameras whose calibration is plausible for their images, and the faults of the others.

    Raises:
        BadInputError: the calibration is of other cameras.
    """
    if not calibration.cameras.keys() & set(dataset.cameras):
        raise BadInputError(
            f"the calibration is of other cameras ({', '.join(calibration.cameras)}) than {dataset.name}",
            hint="choose another one, or: reconstruct calibrate SESSION --replace",
        )
    views, faults = {}, []
    for name in dataset.cameras:
        if (known := calibration.cameras.get(name)) is None:
            continue
        width, height = dataset.size_on_disk(name)
        if why := camera_fault(known):
            faults.append((name, f"the calibration of camera {name} cannot be right: {why}"))
        elif abs(known.width / known.height - width / height) > 0.01 * width / height:
            sizes = f"{known.width}x{known.height}, but its images are {width}x{height}"
            faults.append((name, f"camera {name} is calibrated for {sizes}"))
        else:
            views[name] = View.from_calibration(known, *dataset.size(name))
    misplaced = rig_faults({name: calibration.cameras[name] for name in views}, calibration.unit)
    for name, _ in misplaced:
        views.pop(name, None)
    return views, faults + misplaced


def refuse_faults(dataset: Dataset, views: Container[str], faults: Sequence[Fault]) -> None:
    """Raise BadInputError with all faults, if the whole rig has one or fewer than two cameras are left."""
    left = sum(name in views for name in dataset.cameras)
    if faults and (left < 2 or not all(name for name, _ in faults)):
        heading = f"the calibration of {dataset.name} has {len(faults)} faults: " if len(faults) > 1 else ""
        raise BadInputError(
            heading + "; ".join(text for _, text in faults),
            hint="calibrate the rig again, or correct calibration.json",
        )
