"""Access to the system's aravis library, loaded on first use, and its errors as messages for users."""

import functools
import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from capture_app.cameras.system_packages import load_system_module
from capture_app.common.errors import CameraError, NotAvailableError

PACKAGE = "gir1.2-aravis-0.8"
PURPOSE = "a GigE Vision or USB3 Vision camera"
_VERSION = "0.8"
_WORDS = {
    5: ("{} does not answer any more", "check its power and cable, then start it again"),
    6: (
        "there is no machine-vision camera {}",
        "`capture-app cameras` lists the cameras; one that is on has an address in this network",
    ),
    10: ("{} is in use by another program", "close it: only one can control a camera"),
}
"""Message and hint by the error code of the library's device errors."""


@functools.cache
def load_aravis() -> Any:
    """Return the library's module. Raises NotAvailableError if it is not installed or does not load."""
    gi = load_system_module("gi", PACKAGE, PURPOSE)
    try:
        gi.require_version("Aravis", _VERSION)
        with warnings.catch_warnings():
            # PyGObject's importer uses an older import API than the newest Python.
            warnings.simplefilter("ignore", ImportWarning)
            importlib.import_module("gi.repository.GLib")
            return importlib.import_module("gi.repository.Aravis")
    except (ImportError, ValueError) as error:
        raise NotAvailableError(
            f"{PURPOSE} needs the aravis library, which is not installed",
            hint=f"on Debian and Raspberry Pi OS: sudo apt install {PACKAGE}",
        ) from error


@contextmanager
def camera_errors(device: str) -> Iterator[None]:
    """Convert the library's errors to CameraError while a device is used."""
    library_error = importlib.import_module("gi.repository.GLib").Error
    try:
        yield
    except library_error as error:
        if error.domain != "arv-device-error-quark" or error.code not in _WORDS:
            hint = "another program, such as arv-viewer, may say more"
            raise CameraError(f"{device} failed: {error.message}", hint=hint) from error
        what, hint = _WORDS[error.code]
        raise CameraError(what.format(device), hint=hint) from error
