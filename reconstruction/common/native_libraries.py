"""The one door to native libraries that are heavy, optional, or must be imported in a fixed order."""

import importlib
import platform
import signal
import threading
from importlib import metadata
from types import ModuleType

from capture_app.optional_packages import RECONSTRUCTION, load_optional, require_installed
from reconstruction.common.foreign_calls import GuardedModule, silenced_output


def load_pycolmap(purpose: str, *, hint: str = "") -> ModuleType:
    """COLMAP's Python module, guarded and silent; `purpose` is what the error says it is for.

    OpenCV must be imported first: in the other order the first PNG that OpenCV writes aborts the process.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    importlib.import_module("cv2")
    on_end = signal.getsignal(signal.SIGTERM)
    module = _load("pycolmap", purpose, hint)
    # COLMAP takes the signal for a crash: it prints a stack and ends, and nothing is tidied up.
    if on_end is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_end)
    module.logging.minloglevel = 3
    return GuardedModule(module, "COLMAP")


def load_open3d() -> ModuleType:
    """Open3D, for clouds and meshes; guarded and silent.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    module = _load("open3d", "making a mesh")
    # Its warnings would go through Python's own stdout.
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return GuardedModule(module, "Open3D")


def require_reconstruction(name: str, purpose: str) -> None:
    """Raise NotAvailableError where one of the two is not installed, before long work begins."""
    require_installed(name, RECONSTRUCTION, purpose)


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
    with silenced_output():
        module: ModuleType = load_optional(name, RECONSTRUCTION, purpose, hint=hint)
    return module
