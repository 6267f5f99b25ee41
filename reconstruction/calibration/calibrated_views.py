"""The views of a session's cameras by a calibration."""

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from reconstruction.common.geometry import View
from reconstruction.session.dataset import Dataset


def calibrated_views(dataset: Dataset, calibration: Calibration) -> dict[str, View]:
    """The calibrated cameras among the session's, at the size of their images.

    Raises:
        BadInputError: a calibration was made for images of another shape, or by other cameras.
    """
    if not calibration.cameras.keys() & set(dataset.cameras):
        raise BadInputError(
            f"{dataset.name}'s calibration is of other cameras ({', '.join(calibration.cameras)})",
            hint=f"the session has {', '.join(dataset.cameras)}",
        )
    views = {}
    for name in dataset.cameras:
        known = calibration.cameras.get(name)
        if known is None:
            continue
        width, height = dataset.size(name)
        if abs(known.width / known.height - width / height) > 0.01 * width / height:
            raise BadInputError(
                f"camera {name} is calibrated for {known.width}x{known.height}, "
                f"but its images are {width}x{height}",
                hint="calibrate at the shape of the images",
            )
        views[name] = View.from_calibration(known, width, height)
    return views
