"""Reconstruct recorded sessions and compare synchronized with offset frames.

What Python code calls is here, and loaded when it is first named: docs/python.md. `__init__.pyi` gives type
checkers the same names.
"""

import importlib
from typing import Any

_PUBLIC = {
    "CalibrateOptions": "calibration.calibration_run",
    "CalibrationSource": "calibration.calibration_run",
    "CompareOptions": "compare.comparison",
    "Condition": "session.conditions",
    "open_session": "reconstructed_session",
}


def _method_options() -> dict[str, Any]:
    """Return the options of the installed methods that have a command, by the names of their classes."""
    from reconstruction.compare.method import methods

    return {method.Options.__name__: method.Options for method in methods().values() if method.help}


def __dir__() -> list[str]:
    return [*__getattr__("__all__"), "__doc__"]


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return sorted([*_PUBLIC, *_method_options()])
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    if not name.endswith("Options") or name not in (options := _method_options()):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return options[name]
