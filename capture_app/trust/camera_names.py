"""Whose camera each name is: the pin of the machine that had it first, kept in one file for good."""

import os
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError, DiskError
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.locks import lock_file
from capture_app.text import UNREADABLE, pretty_json

FILE = "names.json"


class CameraNames:
    """The file of them, which all leaders of one user share."""

    def __init__(self, folder: Path) -> None:
        """Raises BadInputError where the file is damaged, DiskError where it cannot be read."""
        self._path = folder / FILE
        self.owners = self._read()
        """By name, the pin of its machine: to be changed by whoever leads, and kept by `keep`."""
        self._kept = dict(self.owners)

    def keep(self) -> None:
        """Put on disk what has changed. Raises DiskError where that cannot be; it is tried again then."""
        if self.owners == self._kept:
            return
        gone = self._kept.keys() - self.owners.keys()
        news = {name: pin for name, pin in self.owners.items() if self._kept.get(name) != pin}
        try:
            lock = lock_file(self._path.with_suffix(".lock"), wait=True)
            try:
                others = {name: pin for name, pin in self._read().items() if name not in gone}
                write_atomic(self._path, pretty_json(others | news))
            finally:
                os.close(lock)
        except OSError as error:
            raise DiskError(f"cannot keep whose camera is whose in {self._path}: {error.strerror}") from error
        self._kept = dict(self.owners)

    def _read(self) -> dict[str, str]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=dict[str, str])
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise DiskError(f"cannot read {self._path}: {error.strerror}") from error
        except UNREADABLE as error:
            raise BadInputError(
                f"{self._path} is damaged: {error}", hint="delete it: cameras keep their names from now on"
            ) from error
