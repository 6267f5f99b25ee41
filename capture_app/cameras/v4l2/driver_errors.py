"""The errors of V4L2 drivers in a user's words."""

import errno
import os

from capture_app.errors import CameraError


def driver_error(path: str, error: OSError) -> CameraError:
    """The driver's error in words that say what to do."""
    match error.errno:
        case errno.ENOENT:
            what, hint = f"there is no camera {path}", "`capture-app cameras` lists the cameras"
        case errno.EACCES | errno.EPERM:
            what = f"no permission to use {path}"
            hint = "add yourself to the group `video`: sudo usermod -aG video $USER, then log in again"
        case errno.EBUSY:
            what = f"{path} is in use by another program"
            hint = f"close it; `fuser -v {path}` names it"
        case errno.ENOTTY | errno.EISDIR | errno.ENXIO:
            what, hint = f"{path} is not a camera", "`capture-app cameras` lists the cameras"
        case errno.ENOSPC:
            what = f"{path} cannot start: the USB bus has no bandwidth left for it"
            hint = "choose format=MJPG, a smaller size or rate, or another USB port"
        case errno.ENODEV | errno.EIO | errno.ESHUTDOWN | errno.EPROTO | errno.ETIMEDOUT:
            what, hint = f"{path} does not answer any more", "check its plug and cable, then start it again"
        case _:
            reason = os.strerror(error.errno) if error.errno else str(error)
            what, hint = f"{path} failed: {reason}", "the kernel log (`dmesg`) may say more"
    return CameraError(what, hint=hint)
