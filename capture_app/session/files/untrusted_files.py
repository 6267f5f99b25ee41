"""Untrusted files: only regular files of bounded size are read, since a pipe could block a reader for ever.

Their JSON is checked against a struct, and so is JSON that is written.
"""

import errno
import io
import os
import re
import stat
import zipfile
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import msgspec

from capture_app.common import system
from capture_app.common.errors import BadInputError, SimulshotError, reading
from capture_app.common.text import UNREADABLE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_T = TypeVar("_T")
MAX_BYTES = 1 << 30
"""Maximum size of a file that is read whole, and of all its arrays unpacked."""
REPEATABLE = ("GLOBAL", "REDUCE", "UNICODE", "BYTE", "STRING")
"""Words in the names of pickle's opcodes whose values may be used again: lists grow with each."""
RESTORE = "restore this file from a copy"
RESTORE_IMAGE = "restore it from a copy; capture-app sessions verify SESSION lists all damaged files"


@contextmanager
def rejecting(what: str, *kinds: type[Exception], hint: str = "") -> Iterator[None]:
    """Raise BadInputError, `what` and the reason in one line, when decoding raises one of these kinds.

    Errors that are for users already pass unchanged.
    """
    try:
        yield
    except SimulshotError:
        raise
    except kinds as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BadInputError(f"{what}: {reason}", hint=hint) from error


def within(count: int, limit: int, what: str) -> int:
    """Return a count of an untrusted file's parts. Raises ValueError if it exceeds the reader's limit."""
    if count > limit:
        raise ValueError(f"it has {count:,} {what}, and {limit:,} at most are read")
    return count


def open_regular(path: Path, *, follow_links: bool = True) -> BinaryIO:
    """Open a regular file for reading. Raises OSError for anything else."""
    handle = system.open_file(path, os.O_RDONLY, follow_links=follow_links)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return os.fdopen(handle, "rb")


def read_regular(path: Path, *, follow_links: bool = True) -> bytes:
    """Return the bytes of a regular file, as `open_regular` opens it."""
    with open_regular(path, follow_links=follow_links) as file:
        return file.read()


def read_input(path: Path, *, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the bytes of a regular file. Raises BadInputError if it cannot be read or has more bytes."""
    with reading(path):
        if (size := path.stat().st_size) > max_bytes:
            raise BadInputError(
                f"{path} has {size:,} bytes, and {max_bytes:,} at most are read",
                hint="is it the file that you meant?",
            )
        return read_regular(path)


def read_text(path: Path, *, encoding: str = "utf-8-sig", max_bytes: int = 1 << 26) -> str:
    """Return a file's text without a byte order mark, as `read_input` does; also raises it for no text.

    A mark of UTF-16, as Excel and PowerShell write it, decides over the encoding.
    """
    with rejecting(f"cannot read {path}", UnicodeDecodeError, hint="save it as UTF-8 text"):
        data = read_input(path, max_bytes=max_bytes)
        return data.decode("utf-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else encoding)


def read_arrays(path: Path, *, max_bytes: int = MAX_BYTES) -> "dict[str, NDArray[np.generic]]":
    """Return the arrays of a .npz file by name. Raises BadInputError if it cannot be read as one.

    `max_bytes`: maximum unpacked size of all of them.
    """
    import numpy as np  # slow to import, and every command imports this module

    data = io.BytesIO(read_input(path, max_bytes=max_bytes))
    with rejecting(
        f"cannot read {path} as arrays (.npz)",
        Exception,  # zipfile, its decompressors and numpy raise a dozen kinds
        hint="restore it from a copy, or write it again with np.savez",
    ):
        with zipfile.ZipFile(data) as archive:
            size = sum(member.file_size for member in archive.infolist())
        within(size, max_bytes, "bytes in its arrays")
        with np.load(data, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}


def check_pickle(data: bytes) -> None:
    """Raise ValueError for a pickle that takes far more memory or time than its size; it is not run."""
    import pickletools  # needed rarely, and every command imports this module

    memo, previous = dict[Any, bool](), ""
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name == "MEMOIZE" or "PUT" in opcode.name:
            place: Any = len(memo) if argument is None else argument
            memo[within(place, len(data), "places")] = any(word in previous for word in REPEATABLE)
        elif opcode.name == "DUP" or ("GET" in opcode.name and not memo.get(argument)):
            raise ValueError("it repeats lists of lists")
        previous = opcode.name


def read_struct(path: Path, kind: type[_T], newest: int | None = None) -> _T:
    """Read a JSON file into a struct; `newest` is the highest supported schema_version.

    Raises BadInputError if the file cannot be read, is not JSON, has a newer version, or does not fit the
    struct; the message gives the place.
    """
    return decode_struct(path, read_input(path), kind, newest)


def decode_struct(path: Path, data: bytes, kind: type[_T], newest: int | None = None) -> _T:
    """Decode JSON as `read_struct` does; `path` is its source."""
    try:
        if newest is not None:
            fields = msgspec.json.decode(data, type=dict[str, msgspec.Raw])
            if (version := msgspec.json.decode(fields.get("schema_version", b"1"), type=int)) > newest:
                raise BadInputError(
                    f"{path} is of schema version {version}; this simulshot reads up to {newest}",
                    hint="a newer simulshot wrote it: update this one",
                )
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{path} does not fit its schema: {error}", hint=RESTORE) from error
    except UNREADABLE as error:
        raise BadInputError(
            f"{path} is not valid JSON: {error}{_line_of(data, str(error))}", hint=RESTORE
        ) from error


def encode_checked(value: msgspec.Struct, what: str = "") -> bytes:
    """Encode a struct. Raises BadInputError if its values violate its schema: constructors check nothing.

    `what` names it in the error.
    """
    data = msgspec.json.encode(value)
    what = what or f"a {type(value).__name__}"
    remedy = "correct what its camera or recording states"
    with rejecting(f"{what} breaks its schema", msgspec.ValidationError, hint=remedy):
        msgspec.json.decode(data, type=type(value))
    return data


def indented(data: bytes) -> bytes:
    """Indent JSON, one value a line."""
    return msgspec.json.format(data, indent=1) + b"\n"


def _line_of(data: bytes, message: str) -> str:
    """Return line and column of msgspec's `(byte N)`, as editors count them."""
    match = re.search(r"\(byte (\d+)\)", message)
    lines = data[: int(match[1])].split(b"\n") if match else []
    return f", line {len(lines)} column {len(lines[-1]) + 1}" if lines else ""
