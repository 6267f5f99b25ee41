"""Plugins, which are entry points of installed packages; only metadata is read until one is loaded."""

import logging
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import cache
from importlib.metadata import EntryPoint, distributions
from typing import Any

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.optional_packages import DISTRIBUTION
from capture_app.common.text import first_line, printable
from capture_app.common.timeouts import NAMED_PLUGIN_TIMEOUT_S, PLUGIN_TIMEOUT_S

COMMANDS = f"{DISTRIBUTION}.commands"
"""Group of the commands of `capture-app` that are plugins."""
CAMERA_COMMANDS = f"{DISTRIBUTION}.camera_commands"
"""Group of the commands of `capture-app cameras` that are plugins."""
SESSION_COMMANDS = f"{DISTRIBUTION}.session_commands"
"""Group of the commands of `capture-app sessions` that are plugins."""
_GROUPS = f"{DISTRIBUTION}."
"""Prefix of the names of all groups."""
_log = logging.getLogger(__name__)


def plugin_names(group: str) -> tuple[str, ...]:
    """Return the sorted names of a group's plugins without importing them."""
    return tuple(_find_plugins(group, tuple(sys.path)))


def load_plugin(group: str, name: str, *attributes: str) -> Any:
    """Import one plugin and check that it has all of `attributes`.

    Raises:
        BadInputError: no installed package has a plugin of this name.
        NotAvailableError: the plugin cannot be imported, or not in time, or lacks an attribute.
    """
    plugins = _find_plugins(group, tuple(sys.path))
    if name not in plugins:
        known = ", ".join(plugins) or f"none; reinstall {DISTRIBUTION}"
        raise BadInputError(f"{name!r} is not in {group}", hint=f"installed: {known}")
    return _load(*plugins[name], attributes, NAMED_PLUGIN_TIMEOUT_S)


def load_plugins(group: str, *attributes: str) -> dict[str, Any]:
    """Import all plugins of a group, by name; report each broken one once, on stderr, and skip it."""
    return dict(_load_all(group, attributes, tuple(sys.path)))


@cache
def _load_all(group: str, attributes: tuple[str, ...], path: tuple[str, ...]) -> Mapping[str, Any]:
    loaded = {}
    for name, (package, entry) in _find_plugins(group, path).items():
        try:
            loaded[name] = _load(package, entry, attributes, PLUGIN_TIMEOUT_S)
        except NotAvailableError as error:
            _log.warning("%s", printable(str(error)))
    return loaded


def _find_plugins(group: str, path: tuple[str, ...]) -> Mapping[str, tuple[str, EntryPoint]]:
    """Return a group's packages and entry points by name, sorted; no package replaces one of simulshot's."""
    entries = [entry for entry in _find_all(path) if entry[1].group == group]
    entries.sort(key=lambda entry: (entry[0] == DISTRIBUTION, entry[0]))
    return dict(sorted({printable(entry.name): (package, entry) for package, entry in entries}.items()))


@cache
def _find_all(path: tuple[str, ...]) -> list[tuple[str, EntryPoint]]:
    """Read all packages on the path once: their names and plugins. Report each damaged one, and skip it."""
    by_name: dict[str, list[EntryPoint]] = {}
    for distribution in distributions():
        try:
            entries = [
                entry_point
                for entry_point in distribution.entry_points
                if entry_point.group.startswith(_GROUPS)
            ]
            if entries and "Name" not in distribution.metadata:
                raise FileNotFoundError("it has no METADATA")
            if entries:  # of two versions of a package, the first one is imported
                by_name.setdefault(distribution.name, entries)
        except Exception as error:  # noqa: BLE001 - whatever other people's packages hold
            _log.warning(
                "the package at %s is skipped: %s (reinstall it, or remove that folder)",
                printable(str(getattr(distribution, "_path", distribution))),
                printable(first_line(error)),
            )
    return [(package, entry) for package, entries in by_name.items() for entry in entries]


def _load(package: str, entry: EntryPoint, attributes: tuple[str, ...], timeout_s: float) -> Any:
    what = f"the plugin {entry.name!r} of {entry.group}"

    def load() -> Any:
        plugin = entry.load()
        if missing := [attribute for attribute in attributes if not hasattr(plugin, attribute)]:
            raise AttributeError(f"it has no {missing[0]!r}")
        return plugin

    try:
        return load() if package == DISTRIBUTION else _in_thread(load, what, timeout_s)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # an import may even call sys.exit
        reason = first_line(error) if isinstance(error, Exception) else repr(error)
        raise NotAvailableError(
            f"{what} does not load: {reason}",
            hint=f"it is {entry.value} of the package {package}: update or uninstall that package",
        ) from error


def _in_thread(load: Callable[[], Any], what: str, timeout_s: float) -> Any:
    """Return what `load` returns, or raise what it raises; it may hang, and is then abandoned."""
    loaded = Future[Any]()

    def run() -> None:
        try:
            loaded.set_result(load())
        except BaseException as error:  # noqa: BLE001 - raised below
            loaded.set_exception(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PLUGIN_TIMEOUT_S)
    if thread.is_alive() and timeout_s > PLUGIN_TIMEOUT_S:
        _log.warning("%s is still being imported", what)
        thread.join(timeout_s - PLUGIN_TIMEOUT_S)
    if thread.is_alive():
        raise TimeoutError(f"it is still being imported after {timeout_s:g} s")
    return loaded.result()
