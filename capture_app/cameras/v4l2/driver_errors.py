"""Messages to users for the errors of V4L2 drivers."""

import errno
import os

from capture_app.common.errors import CameraError

_LIST = "`capture-app cameras` lists the cameras"
_NO_CAMERA = "{path} is not a camera", _LIST
_NOT_PERMITTED = (
    "no permission to use {path}",
    "add yourself to the group `video`: sudo usermod -aG video $USER, then log in again",
)
_SILENT = "{path} does not answer any more", "check its plug and cable, then start it again"
_WORDS = {
    errno.ENOENT: ("there is no camera {path}", _LIST),
    errno.EACCES: _NOT_PERMITTED,
    errno.EPERM: _NOT_PERMITTED,
    errno.EBUSY: ("{path} is in use by another program", "close it; `fuser -v {path}` names it"),
    **dict.fromkeys((errno.ENOTTY, errno.EISDIR, errno.ENXIO), _NO_CAMERA),
    errno.ENOSPC: (
        "{path} cannot start: the USB bus has no bandwidth left for it",
        "choose format=MJPG, a smaller size or rate, or another USB port",
    ),
    **dict.fromkeys((errno.ENODEV, errno.EIO, errno.ESHUTDOWN, errno.EPROTO, errno.ETIMEDOUT), _SILENT),
}


def driver_error(path: str, error: OSError) -> CameraError:
    """Convert a driver's error to a message with a remedy."""
    words = _WORDS.get(error.errno or 0)
    if words is None:
        reason = os.strerror(error.errno) if error.errno else str(error)
        return CameraError(f"{path} failed: {reason}", hint="the kernel log (`dmesg`) may say more")
    what, hint = words
    return CameraError(what.format(path=path), hint=hint.format(path=path))
