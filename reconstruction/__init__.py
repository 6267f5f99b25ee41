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
    "MultiviewOptions": "multiview.instant_model",
    "PanoramaOptions": "panorama.panorama_run",
    "StereoOptions": "stereo.stereo_run",
    "open_session": "reconstructed_session",
}
__all__ = list(_PUBLIC)


def __dir__() -> list[str]:
    return [*__all__, "__doc__"]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
