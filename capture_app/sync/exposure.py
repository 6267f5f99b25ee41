"""The moment of a frame that is aligned: the first row's start, or the middle of a chosen row's exposure.

Cameras with different exposures or readouts begin together and yet see different moments; where it is asked
for, they are aligned by the middle of what one row sees.
"""

from capture_app.sync.messages import CameraDescription


def offset_ns(camera: CameraDescription, share: float | None) -> int | None:
    """Time in ns from a frame's timestamp to the middle of the exposure of the row at that share of height.

    0 for `share` None: the timestamp itself is aligned. None where the camera's rows or exposure, or what its
    timestamps mean, is not known.
    """
    if share is None:
        return 0
    if camera.row_time_ns is None or camera.exposure_ns is None:
        return None
    below = round(share * (camera.height - 1))
    if camera.timestamp_source == "start-of-exposure":
        return below * camera.row_time_ns + camera.exposure_ns // 2
    if camera.timestamp_source == "end-of-frame":
        return -(camera.height - 1 - below) * camera.row_time_ns - camera.exposure_ns // 2
    return None
