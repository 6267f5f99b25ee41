"""Packages that only some exports need, imported when one of them runs."""

from typing import Any

from capture_app.optional_packages import load_optional


def load_package(module: str, needed_for: str, extra: str = "export") -> Any:
    """Import a module of an optional extra. Raises NotAvailableError, which says what to type."""
    return load_optional(module, extra, needed_for)
