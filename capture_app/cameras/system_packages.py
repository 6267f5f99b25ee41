"""Import of system Python modules, such as Debian's libcamera and gi, from any Python environment.

They are bindings of the system's own libraries, so pip has none that fit. An environment without
`--system-site-packages` does not see them; one with it sees every other system package, too.
"""

import importlib
import re
import sys
import threading
from collections.abc import Sequence
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import Any

from capture_app.common.errors import NotAvailableError

_VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
FOLDERS = (
    "/usr/lib/python3/dist-packages",
    f"/usr/lib64/python{_VERSION}/site-packages",
    f"/usr/lib/python{_VERSION}/site-packages",
)
"""Folders of the distributions' own Python modules: Debian's for all its versions, then others."""
_lock = threading.Lock()
"""Held while a module is loaded: another thread would be given it half-made."""
_SUFFIXES = frozenset(suffix.removeprefix(".") for suffix in EXTENSION_SUFFIXES)


def load_system_module(
    module: str, package: str, purpose: str, *, folders: Sequence[str | Path] = FOLDERS
) -> Any:
    """Import one top-level module of the system's Python, without exposing any other.

    `package` is the Debian package that provides it; `purpose` says in the error what it is needed for.

    Raises:
        NotAvailableError: it is not installed, is built for another version of Python, or does not load.
    """
    with _lock:
        return sys.modules[module] if module in sys.modules else _import(module, package, purpose, folders)


def _import(module: str, package: str, purpose: str, folders: Sequence[str | Path]) -> Any:
    own = find_spec(module)
    spec = own or _system_spec(module, folders)
    if spec is None:
        raise NotAvailableError(
            f"{purpose} needs the system's Python module {module}, which is not installed",
            hint=f"on Debian and Raspberry Pi OS: sudo apt install {package}",
        )
    versions = _other_versions(spec)
    if versions:
        raise NotAvailableError(
            f"{purpose} needs the system's Python module {module}, which is there for Python"
            f" {' and '.join(versions)}; this is Python {_VERSION}",
            hint=f"install simulshot for the system's own: PYTHON=/usr/bin/python{versions[-1]} ./install.sh",
        )
    try:
        return importlib.import_module(module) if own else _load(spec)
    except (ImportError, OSError) as error:
        raise NotAvailableError(
            f"{purpose} needs the system's Python module {module}, which does not load here: {error}",
            hint=f"on Debian and Raspberry Pi OS: sudo apt install --reinstall {package}",
        ) from error


def is_installed(module: str) -> bool:
    """Return whether the system's Python has the module, for any Python version."""
    return module in sys.modules or (find_spec(module) or _system_spec(module, FOLDERS)) is not None


def _system_spec(module: str, folders: Sequence[str | Path]) -> ModuleSpec | None:
    specs = (PathFinder.find_spec(module, [str(folder)]) for folder in folders)
    # Without a loader it is a folder left behind by a removed package.
    return next((spec for spec in specs if spec is not None and spec.loader is not None), None)


def _load(spec: ModuleSpec) -> Any:
    """Load a module from its spec; its submodules are then found through its own path."""
    module = module_from_spec(spec)
    assert spec.loader is not None
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[spec.name]
        raise
    return module


def _other_versions(spec: ModuleSpec) -> list[str]:
    """Return the Python versions a package is compiled for, oldest first; empty if it fits this one."""
    compiled = [
        file.name for folder in spec.submodule_search_locations or () for file in Path(folder).glob("*.so")
    ]
    if any(name.partition(".")[2] in _SUFFIXES for name in compiled):
        return []
    modules = {
        (int(m[1]), int(m[2])) for name in compiled if (m := re.compile(r"\.cpython-(\d)(\d+)-").search(name))
    }
    return [f"{major}.{minor}" for major, minor in sorted(modules)]
