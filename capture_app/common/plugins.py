"""Plugins, which are entry points of installed packages; only metadata is read until one is loaded."""

import logging
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from typing import Any

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.optional_packages import DISTRIBUTION
from capture_app.common.text import first_line

_log = logging.getLogger(__name__)


def plugin_names(group: str) -> tuple[str, ...]:
    """Return the sorted names of a group's plugins without importing them."""
    return tuple(_entry_points(group))


def load_plugin(group: str, name: str, *attributes: str) -> Any:
    """Import one plugin and check that it has all of `attributes`.

    Raises:
        BadInputError: no installed package has a plugin of this name.
        NotAvailableError: the plugin cannot be imported, or lacks an attribute.
    """
    found = _entry_points(group)
    if name not in found:
        known = ", ".join(found) or f"none; reinstall {DISTRIBUTION}"
        raise BadInputError(f"{name!r} is not in {group}", hint=f"installed: {known}")
    return _load(found[name], attributes)


def load_plugins(group: str, *attributes: str) -> dict[str, Any]:
    """Import all plugins of a group, by name; report each broken one in one line on stderr and skip it."""
    loaded = {}
    for name, entry in _entry_points(group).items():
        try:
            loaded[name] = _load(entry, attributes)
        except NotAvailableError as error:
            _log.warning("%s", error)
    return loaded


def _entry_points(group: str) -> Mapping[str, EntryPoint]:
    """Return a group's entry points by name, sorted; no other package replaces one of simulshot's."""
    return _find_entry_points(group, tuple(sys.path))


@cache
def _find_entry_points(group: str, path: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    """Read the metadata of all packages on the path, once: a command line asks for it several times."""
    package_of = cache(_package)  # which reads a package's metadata, too
    found = sorted(entry_points(group=group), key=lambda entry: package_of(entry.dist), reverse=True)
    found.sort(key=lambda entry: package_of(entry.dist) == DISTRIBUTION)
    return dict(sorted({entry.name: entry for entry in found}.items()))


def _package(distribution: Distribution | None) -> str:
    return distribution.name if distribution else ""


def _load(entry: EntryPoint, attributes: tuple[str, ...]) -> Any:
    try:
        plugin = entry.load()
        if missing := [one for one in attributes if not hasattr(plugin, one)]:
            raise AttributeError(f"it has no {missing[0]!r}")
    except Exception as error:
        package = _package(entry.dist)
        raise NotAvailableError(
            f"the plugin {entry.name!r} of {entry.group} does not load: {first_line(error)}",
            hint=f"it is {entry.value} of the package {package}: update or uninstall that package",
        ) from error
    return plugin
