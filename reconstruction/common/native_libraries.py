"""Access to OpenCV, COLMAP and Open3D: import order, conversion of errors, and silenced output."""

import os
import platform
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from traceback import extract_tb
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.optional_packages import RECONSTRUCTION, load_optional

MAX_WORDS = 30
TRACEBACK = "SIMULSHOT_TRACEBACK"
"""Environment variable that makes an unexpected exception end in a traceback."""


class ForeignError(BadInputError):
    """A library failed on its input."""


@contextmanager
def foreign_calls(library: str, purpose: str) -> Iterator[None]:
    """Run library calls that may fail or print: silence their output and convert their errors.

    Raises:
        ForeignError: the library raised an exception.
    """
    try:
        with silenced_output():
            yield
    except (SimulshotError, OSError):
        raise
    except MemoryError as error:
        raise ForeignError(
            f"{library} has too little memory for {purpose}",
            hint="set a smaller SIMULSHOT_MEMORY in the environment, or end other programs",
        ) from error
    except Exception as error:
        raise ForeignError(f"{library} failed at {purpose}: {_first_words(error)}") from error


@contextmanager
def opencv_calls(purpose: str) -> Iterator[None]:
    """Run code that also calls OpenCV, and convert OpenCV's exceptions, but no others.

    Raises:
        ForeignError: OpenCV raised an exception.
    """
    try:
        yield
    except Exception as error:
        if not _is_opencv(error):
            raise
        raise ForeignError(f"OpenCV failed at {purpose}: {_first_words(error)}") from error


def unexpected_error(error: Exception) -> SimulshotError:
    """Convert an unexpected exception into an error that says where it came from."""
    if isinstance(error, MemoryError):
        return ForeignError("there is too little memory", hint="set SIMULSHOT_MEMORY, or end other programs")
    if _is_opencv(error):
        return ForeignError(f"OpenCV failed: {_first_words(error)}")
    frames = [frame for frame in extract_tb(error.__traceback__) if "site-packages" not in frame.filename]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "an unknown place"
    return SimulshotError(
        f"unexpected {type(error).__name__} in {where}: {_first_words(error)}",
        hint=f"this is a bug; set {TRACEBACK}=1 in the environment to see the traceback",
    )


def _is_opencv(error: Exception) -> bool:
    # By name: this module is loaded before OpenCV is.
    return type(error).__module__ == "cv2"


def _first_words(error: Exception) -> str:
    """Return an exception's message on one line."""
    origin = f"{getattr(error, 'func', '')}: " if _is_opencv(error) else ""
    words = f"{origin}{getattr(error, 'err', '') or str(error) or type(error).__name__}".split()
    return " ".join(words[:MAX_WORDS]) + (" ..." if len(words) > MAX_WORDS else "")


class GuardedModule(ModuleType):
    """A module whose functions, including its submodules', run inside `foreign_calls`."""

    def __init__(self, module: ModuleType, library: str) -> None:
        super().__init__(module.__name__, module.__doc__)
        self._module = module
        self._library = library

    def __getattr__(self, name: str) -> Any:
        """Return functions and submodules guarded, everything else unchanged."""
        member = getattr(self._module, name)
        if isinstance(member, ModuleType):
            member = GuardedModule(member, self._library)
        elif isinstance(member, BuiltinFunctionType | FunctionType):
            member = foreign_calls(self._library, member.__name__.replace("_", " "))(member)
        setattr(self, name, member)
        return member


_lock = threading.Lock()
_silenced = 0
_originals: dict[int, int] = {}
"""While output is silenced: standard streams, and duplicates of their original targets."""


@contextmanager
def silenced_output() -> Iterator[None]:
    """Discard native code's output to stdout and stderr; failures are raised as errors instead."""
    global _silenced
    with _lock:
        _silenced += 1
        if _silenced == 1:
            for file in (sys.stdout, sys.stderr):
                with suppress(OSError, AttributeError, ValueError):
                    file.flush()
            _silence(1, 2)
    try:
        yield
    finally:
        with _lock:
            _silenced -= 1
            while not _silenced and _originals:
                stream, original = _originals.popitem()
                os.dup2(original, stream)
                os.close(original)


def claim_output() -> None:
    """Reserve stdout for this process's own output; native code's output to it goes to stderr.

    Our own messages on stderr appear while native code is silenced.
    """
    with suppress(OSError, AttributeError, ValueError):
        sys.stdout.flush()
        ours = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors="replace")
        os.dup2(2, 1)
        sys.stdout = ours
    with suppress(OSError, AttributeError, ValueError):
        sys.stderr = os.fdopen(os.dup(2), "w", 1, encoding=sys.stderr.encoding, errors="replace")


def _silence(*streams: int) -> None:
    with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
        for stream in streams:
            # A closed stream stays closed.
            with suppress(OSError):
                _originals[stream] = os.dup(stream)
                os.dup2(nowhere.fileno(), stream)


def load_open3d() -> ModuleType:
    """Load Open3D, for clouds and meshes, guarded and silent.

    Raises:
        NotAvailableError: it is not installed or cannot be loaded on this machine.
    """
    module = load_guarded("open3d", "making a mesh")
    # Its warnings would go to Python's own stdout.
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return GuardedModule(module, "Open3D")


def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that determine the results, for the record."""
    versions = {"python": platform.python_version()}
    for name in ("simulshot", "numpy", "opencv-python-headless", "pycolmap"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def load_guarded(name: str, purpose: str, hint: str = "") -> ModuleType:
    """Load a package of the extra `reconstruction` silently, or raise NotAvailableError for a purpose."""
    with silenced_output():
        module: ModuleType = load_optional(name, RECONSTRUCTION, purpose, hint=hint)
    return module
