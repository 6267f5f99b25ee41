"""Small JSON file in the folder of keys, shared by a user's processes, which change it one at a time."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from capture_app.common.errors import BadInputError, DiskError
from capture_app.common.text import UNREADABLE, pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.locks import lock_file

T = TypeVar("T")


class StateFile(Generic[T]):
    """Persistent value of type `T`; `empty` if the file does not exist."""

    def __init__(self, path: Path, kind: type[T], empty: T, if_damaged: str) -> None:
        """`if_damaged` is the hint in the error that a damaged file raises."""
        self.path, self._empty, self._if_damaged = path, empty, if_damaged
        self._decoder = msgspec.json.Decoder(kind)

    def read(self) -> T:
        """Return the value. Raises BadInputError for a damaged file, DiskError for an unreadable one."""
        try:
            return self._decoder.decode(self.path.read_bytes())
        except FileNotFoundError:
            return self._empty
        except OSError as error:
            raise DiskError(
                f"cannot read {self.path}: {error.strerror}", hint="check its permissions and the disk"
            ) from error
        except UNREADABLE as error:
            raise BadInputError(f"{self.path} is damaged: {error}", hint=self._if_damaged) from error

    def change(self, change: Callable[[T], T]) -> None:
        """Replace the value by `change` of it. Raises DiskError, and as `read` does."""
        try:
            lock = lock_file(self.path.with_suffix(".lock"), wait=True)
            try:
                write_atomic(self.path, pretty_json(change(self.read())))
            finally:
                os.close(lock)
        except OSError as error:
            raise DiskError(
                f"cannot write {self.path}: {error.strerror}", hint="check its permissions and free space"
            ) from error
