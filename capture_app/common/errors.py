"""Every mistake a user can make ends here: one clear line and one exit code."""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of both commands."""

    OK = 0
    FAILURE = 1
    USAGE = 2
    BAD_INPUT = 3
    NO_CAMERA = 4
    NETWORK = 5
    NOT_AVAILABLE = 6
    INCOMPLETE = 7
    INTERRUPTED = 130


class SimulshotError(Exception):
    """An error that a user can act on: what is wrong and where, and what to do next."""

    exit_code = ExitCode.FAILURE

    def __init__(self, what: str, *, hint: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.what} ({self.hint})" if self.hint else self.what


class BadInputError(SimulshotError):
    """A file, folder, session or value that cannot be used as it is."""

    exit_code = ExitCode.BAD_INPUT


class NotApplicableError(BadInputError):
    """What was asked for cannot be made of this input, sound as it is: its cameras share too little, say."""


class CameraError(SimulshotError):
    """A camera that is missing, busy, or cannot do what was asked."""

    exit_code = ExitCode.NO_CAMERA


class NetworkError(SimulshotError):
    """A port in use, a leader that does not answer, a broken transfer."""

    exit_code = ExitCode.NETWORK


class UnknownMachineError(NetworkError):
    """One machine does not know the other, or only as something else: a person has to confirm it, once."""


class NotAvailableError(SimulshotError):
    """Something this machine or installation does not have."""

    exit_code = ExitCode.NOT_AVAILABLE


class IncompleteError(SimulshotError):
    """A burst or a session that lacks images."""

    exit_code = ExitCode.INCOMPLETE


class NoCameraHereError(IncompleteError):
    """A burst was ordered and no camera has joined the leader."""


class DiskError(SimulshotError):
    """A disk that cannot be written or read at present: read-only, or with an error of its device."""


class DiskFullError(DiskError):
    """A disk without room for what is to be written; room can be made, and then it goes on."""


class TryAgainError(BadInputError):
    """What did not go this time and may go later, as it is: a session in use, an image damaged on its way."""


class CancelledBurstError(BadInputError):
    """A node brings images of a burst that was cancelled: it may delete them."""


@contextmanager
def reading(path: object) -> Iterator[None]:
    """Raise BadInputError, with the path, where a file cannot be read."""
    try:
        yield
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror or error}") from error


@contextmanager
def ungrouped_errors() -> Iterator[None]:
    """Raise the first error of this program out of a group, as of tasks that ran side by side, by itself.

    Others stay in their group. It cannot be raised in an `except*` clause: before Python 3.11.4 that puts it
    into a group again.
    """
    try:
        yield
    except BaseExceptionGroup as group:
        ours, others = group.split(SimulshotError)
        if others is not None or ours is None:
            raise
        raise _first(ours) from None


def _first(group: BaseExceptionGroup[SimulshotError]) -> SimulshotError:
    error = group.exceptions[0]
    return _first(error) if isinstance(error, BaseExceptionGroup) else error
