"""Errors that a user can act on: one line of text and an exit code each."""

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
    """Error that a user can act on: what is wrong and where, and what to do next."""

    exit_code = ExitCode.FAILURE

    def __init__(self, what: str, *, hint: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.what} ({self.hint})" if self.hint else self.what


class BadInputError(SimulshotError):
    """File, folder, session or value that is not usable."""

    exit_code = ExitCode.BAD_INPUT


class NotApplicableError(BadInputError):
    """Request that does not apply to this input, though it is valid: its cameras overlap too little, say."""


class CameraError(SimulshotError):
    """Camera that is missing, busy, or incapable of a request."""

    exit_code = ExitCode.NO_CAMERA


class NetworkError(SimulshotError):
    """Port in use, leader that does not answer, or broken transfer."""

    exit_code = ExitCode.NETWORK


class UnknownMachineError(NetworkError):
    """The other machine does not know this one, or has not given it the role; a person has to pair them."""


class NotAvailableError(SimulshotError):
    """Feature that this machine or installation lacks."""

    exit_code = ExitCode.NOT_AVAILABLE


class IncompleteError(SimulshotError):
    """Burst or session that lacks images."""

    exit_code = ExitCode.INCOMPLETE


class NoCameraHereError(IncompleteError):
    """Burst ordered while no camera has joined the leader."""


class DiskError(SimulshotError):
    """Disk that cannot be written or read at present: read-only, or with a device error."""


class DiskFullError(DiskError):
    """Disk without free space for a write; once there is space, the work goes on."""


class TryAgainError(BadInputError):
    """Temporary failure that a later attempt may not meet: a session in use, an image damaged in transit."""


class DamagedImageError(BadInputError):
    """Images that were damaged before they were sent: the sending node reports them as missing."""

    def __init__(self, what: str, *, hint: str = "", instants: tuple[int, ...] = ()) -> None:
        """`instants` are the damaged ones of several images that were sent together."""
        super().__init__(what, hint=hint)
        self.instants = instants


class UnwantedImageError(BadInputError):
    """Image of a cancelled burst: the sending node may delete it."""


@contextmanager
def reading(path: object) -> Iterator[None]:
    """Raise BadInputError, with the path, if a file cannot be read."""
    try:
        yield
    except OSError as error:
        raise BadInputError(
            f"cannot read {path}: {error.strerror or error}", hint="check the path and its permissions"
        ) from error


@contextmanager
def ungrouped_errors() -> Iterator[None]:
    """Convert an exception group of SimulshotErrors, as concurrent tasks raise, to its first error.

    A group with other errors is raised unchanged. The error is not raised in an `except*` clause: before
    Python 3.11.4 that would put it into a group again.
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
