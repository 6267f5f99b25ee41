"""Take pictures of the same instant with many ordinary cameras.

What Python code calls is here, and loaded when it is first named: docs/python.md. `__init__.pyi` gives type
checkers the same names.
"""

import importlib
from typing import Any

__version__ = "0.1.0"
_PUBLIC = {
    "AsyncRig": "rig.rig",
    "ExportedBurst": "session.exporting.exported_burst",
    "Exporter": "session.exporting.exporter",
    "Rig": "rig.rig",
    "SimulshotError": "common.errors",
    "TakePlan": "rig.taking",
    "open_session": "session.reading.array_access",
}
__all__ = list(_PUBLIC)


def __dir__() -> list[str]:
    return [*__all__, "__doc__", "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
