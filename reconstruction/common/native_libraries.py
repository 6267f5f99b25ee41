"""The one door to native libraries that are heavy, optional, or must be imported in a fixed order."""

import importlib
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from types import ModuleType

from capture_app.errors import NotAvailableError


def load_pycolmap(purpose: str, *, hint: str = "") -> ModuleType:
    """COLMAP's Python module, with its chatter turned off; `purpose` is what the error says it is for.

    OpenCV must be imported first: in the other order the first PNG that OpenCV writes aborts the process.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    importlib.import_module("cv2")
    module = _load("pycolmap", purpose, hint)
    module.logging.minloglevel = 3
    return module


def load_open3d() -> ModuleType:
    """Open3D, for clouds and meshes.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    return _load("open3d", "making a mesh")


@contextmanager
def silenced_stderr() -> Iterator[None]:
    """Discard what native code writes to stderr: its failures become errors of our own."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def library_versions() -> dict[str, str]:
    """Versions of the libraries that decide the figures, for the record."""
    found = {"python": platform.python_version()}
    for name in ("simulshot", "numpy", "opencv-python-headless", "pycolmap"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def _load(name: str, purpose: str, hint: str = "") -> ModuleType:
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        raise NotAvailableError(
            f"{purpose} needs {name}, which this machine cannot load: {error}",
            hint=f"{name} has no package for every machine (this one: {platform.system()} "
            f"{platform.machine()}, Python {platform.python_version()}); "
            f"copy the session to a 64-bit PC{hint}",
        ) from error
