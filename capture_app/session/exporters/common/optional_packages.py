"""Packages that only some exports need, imported when one of them runs."""

import importlib
from typing import Any

from capture_app.errors import NotAvailableError


def load_package(module: str, needed_for: str, extra: str = "export") -> Any:
    """Import a module of an optional extra. Raises NotAvailableError, which says what to type."""
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        package = module.partition(".")[0]
        raise NotAvailableError(
            f"{needed_for} needs {package}, which is not installed here",
            hint=f"pip install 'simulshot[{extra}]'",
        ) from error
