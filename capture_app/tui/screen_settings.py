"""Settings in the user's config folder: the screen's stored choices, and changed keys."""

import json
import threading
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from platformdirs import user_config_path

from capture_app.session.files.durable import write_atomic

Choice = str | int | float | bool
C = TypeVar("C", bound=Choice)

CHOICES_FILE = "screen.json"
KEYS_FILE = "keys.toml"


@dataclass(slots=True)
class Settings:
    """Choices by name, such as `shoot.frames`, and keys by action name.

    An unreadable file causes a warning and falls back to the defaults; it never ends the program.
    """

    folder: Path | None = None
    """Folder of both files; None: settings are not stored."""
    keys: dict[str, str] = field(default_factory=dict)
    """Keys by action, as in keys.toml: {"shoot.take": "space,enter"}."""
    warnings: list[str] = field(default_factory=list)
    """Files or entries that could not be read, one sentence each."""
    on_change: Callable[[], object] = lambda: None
    """Called when a choice changes."""
    choices: dict[str, Choice] = field(default_factory=dict)
    _writing: threading.Lock = field(default_factory=threading.Lock, repr=False)
    """Serializes saves: a concurrent save would move the file that another is writing."""

    @classmethod
    def load(cls, folder: Path | None = None) -> "Settings":
        """Load the settings from the user's config folder, or from another folder."""
        settings = cls(user_config_path("simulshot", appauthor=False) if folder is None else folder)
        settings.choices = {
            name: value for name, value in settings._read(CHOICES_FILE).items() if isinstance(value, Choice)
        }
        for action, key in _flat(settings._read(KEYS_FILE)):
            if isinstance(key, str) and key.strip(", "):
                settings.keys[action] = key
            else:
                settings.warnings.append(
                    f'{KEYS_FILE}: {action} has no key: write it as {action} = "x", and two as "x,space"'
                )
        return settings

    def recall(self, name: str, default: C) -> C:
        """Return the stored choice of a name if it has the default's type, otherwise the default."""
        value = self.choices.get(name, default)
        return value if type(value) is type(default) else default

    def remember(self, name: str, value: Choice) -> None:
        """Store a choice for the next start."""
        if self.choices.get(name) != value:
            self.choices[name] = value
            self.on_change()

    def save(self) -> None:
        """Write the choices to disk; may block. Raises OSError."""
        if self.folder is None or not self.choices:
            return
        with self._writing:
            self.folder.mkdir(parents=True, exist_ok=True)
            text = json.dumps(self.choices, indent=2, sort_keys=True) + "\n"
            write_atomic(self.folder / CHOICES_FILE, text.encode())

    def _read(self, name: str) -> dict[str, Any]:
        assert self.folder is not None
        path = self.folder / name
        try:
            text = path.read_text(encoding="utf-8")
            found = json.loads(text) if name == CHOICES_FILE else tomllib.loads(text)
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, RecursionError) as error:
            self.warnings.append(f"{path} is ignored, as it cannot be read: {error}")
            return {}
        if not isinstance(found, dict):
            self.warnings.append(f"{path} is ignored: it is not a table of names and values")
            return {}
        return found


def _flat(table: dict[str, Any], above: str = "") -> list[tuple[str, Any]]:
    """Return the values of nested tables by dotted name: TOML parses `shoot.take` as a table."""
    found: list[tuple[str, Any]] = []
    for name, value in table.items():
        found += _flat(value, f"{above}{name}.") if isinstance(value, dict) else [(above + name, value)]
    return found
