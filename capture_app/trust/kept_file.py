"""A small JSON file in the folder of keys, which processes of one user share and change one at a time."""

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


class KeptFile(Generic[T]):
    """What is kept there; `empty` where the file is not."""

    def __init__(self, path: Path, kind: type[T], empty: T, if_damaged: str) -> None:
        """`if_damaged` says what to do then."""
        self.path, self._empty, self._if_damaged = path, empty, if_damaged
        self._decoder = msgspec.json.Decoder(kind)

    def read(self) -> T:
        """Return it. Raises BadInputError for a damaged file, DiskError for one that cannot be read."""
        try:
            return self._decoder.decode(self.path.read_bytes())
        except FileNotFoundError:
            return self._empty
        except OSError as error:
            raise DiskError(f"cannot read {self.path}: {error.strerror}") from error
        except UNREADABLE as error:
            raise BadInputError(f"{self.path} is damaged: {error}", hint=self._if_damaged) from error

    def change(self, change: Callable[[T], T]) -> None:
        """Put what `change` makes of it in its place. Raises DiskError, and as `read` does."""
        try:
            lock = lock_file(self.path.with_suffix(".lock"), wait=True)
            try:
                write_atomic(self.path, pretty_json(change(self.read())))
            finally:
                os.close(lock)
        except OSError as error:
            raise DiskError(f"cannot write {self.path}: {error.strerror}") from error
