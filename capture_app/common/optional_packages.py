"""Optional packages: how they are imported, and the commands that install them."""

import importlib
import platform
import shutil
import sys
from importlib.metadata import PackageNotFoundError, metadata, requires
from importlib.util import find_spec
from typing import Any

from capture_app.common.errors import NotAvailableError
from capture_app.common.text import command_line

DISTRIBUTION = "simulshot"
RECONSTRUCTION = "reconstruction"
_OPEN3D = "open3d-cpu"
"""Open3D without CUDA; it and the distribution `open3d` hold the same module, and pip overwrites either."""
_WINDOWS_RUNTIME = "install Microsoft's runtime of Visual C++: winget install Microsoft.VCRedist.2015+.x64"
_SYSTEM_LIBRARIES = "libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0"


def load_optional(module: str, extra: str, purpose: str, *, hint: str = "") -> Any:
    """Import a module of an extra; the error names its `purpose`, and `hint` as an alternative.

    Raises:
        NotAvailableError: it is not installed, has no package for this machine, or does not load.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        missing = isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == package
        if not missing:
            needed = f"on Debian: apt-get install {_SYSTEM_LIBRARIES}" if extra == RECONSTRUCTION else ""
            needed = _WINDOWS_RUNTIME if sys.platform == "win32" else needed
            raise NotAvailableError(
                f"{purpose} needs {package}, which does not load here: {error}",
                hint="; or ".join(filter(None, (needed, hint))),
            ) from error
        raise _not_installed(package, extra, purpose, hint) from error


def require_reconstruction(package: str, purpose: str) -> None:
    """Check before long work that a package of reconstruction is installed, without importing it.

    Raises:
        NotAvailableError: it is not installed, or has no package for this machine.
    """
    if not is_here(package):
        raise _not_installed(package, RECONSTRUCTION, purpose)


def is_here(module: str) -> bool:
    """Return whether a module is installed, without importing it."""
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):
        return False


def _not_installed(package: str, extra: str, purpose: str, hint: str = "") -> NotAvailableError:
    return NotAvailableError(
        f"{purpose} needs {package}, which is not installed",
        hint="; or ".join(filter(None, (how_to_install(extra), hint))),
    )


def how_to_install(extra: str) -> str:
    """Return how this Python installs the packages of an extra, or that this machine cannot have them.

    The packages are named individually: simulshot is not on PyPI, and any package of that name there is
    unrelated.
    """
    from packaging.requirements import Requirement

    try:
        offered = metadata(DISTRIBUTION).get_all("Provides-Extra") or ()
        known = [Requirement(line) for line in requires(DISTRIBUTION) or ()]
    except PackageNotFoundError:
        offered, known = (), []
    if extra not in offered:
        return f"install simulshot with its extra {extra}, in a clone by ./install.sh --with {extra}"
    here = {"sys_platform": sys.platform, "platform_machine": platform.machine()}
    needed = [
        command_line(f"{need.name}{need.specifier}")
        for need in known
        if need.marker
        and need.marker.evaluate({**here, "extra": extra})
        and not need.marker.evaluate({**here, "extra": ""})
        and not (need.name == _OPEN3D and is_here("open3d"))
    ]
    if not needed:
        return (
            f"it has no package for this machine, {platform.system()} on {platform.machine()}: "
            "copy the session to a PC with Linux on x86-64"
        )
    python = command_line(sys.executable)
    if find_spec("pip") is not None:
        installer = f"{python} -m pip install"
    elif shutil.which("uv"):
        installer = f"uv pip install --python {python}"
    else:
        return f"install simulshot with its extra {extra}, in a clone by ./install.sh --with {extra}"
    return f"{installer} {' '.join(needed)}"
