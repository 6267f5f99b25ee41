"""Reconstruct recorded sessions and compare synchronized with offset frames.

What Python code calls is here, and loaded when it is first named: docs/python.md. `__init__.pyi` gives type
checkers the same names.
"""

import importlib
from typing import Any

_PUBLIC = {
    "CalibrateOptions": "scene.calibration_run",
    "CalibrationSource": "scene.calibration_run",
    "CompareOptions": "compare.comparison",
    "Condition": "scene.conditions",
    "open_session": "reconstructed_session",
}


def _methods() -> dict[str, Any]:
    """Return the installed methods that have a command, by the names of their classes."""
    from reconstruction.method.interface import methods

    return {method.__name__: method for method in methods().values()}


def __dir__() -> list[str]:
    return [*__getattr__("__all__"), "__doc__"]


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return sorted([*_PUBLIC, *_methods()])
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    if not name[0].isupper() or (method := _methods().get(name)) is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return method
