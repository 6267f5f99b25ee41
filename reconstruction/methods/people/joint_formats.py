"""Interface of joint formats: each entry point names a `JointReader` or a `JointWriter`.

Built-in ones are entry points, too, so that a package adds a format, and each can be deleted.
"""

import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from capture_app.common.optional_packages import load_optional
from capture_app.common.plugins import load_plugins
from capture_app.session.files.untrusted_files import read_input, rejecting, within
from reconstruction.common.geometry import Array
from reconstruction.methods.people.skeletons import Skeleton, skeleton_of

READERS, WRITERS = "simulshot.joint_readers", "simulshot.joint_writers"
MAX_NUMBERS = 1 << 25
"""Maximum number of numbers in all frames of a camera."""


class Labels(NamedTuple):
    """One camera's labels: pixels (rows, n, joints, 2), NaN = unseen, and confidences (rows, n, joints).

    `numbers` are the rows' frames, as the program counts them. `names` are the individuals' if they are
    followed; else empty.
    """

    skeleton: Skeleton
    numbers: Sequence[int]
    pixels: Array
    confidence: Array
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class JointReader:
    """A program whose joints in images `--keypoints` reads."""

    program: str
    suffixes: Sequence[str]
    """Suffixes of its files, in lower case."""
    read: Callable[[Sequence[Path]], Labels | Sequence[Labels] | None]
    """`read(files)`: return the labels of one camera's files; None if they are another program's.

    Files are one, or several JSON files of a folder. A sequence of labels is of all cameras, in the order of
    their names. Any ValueError, LookupError, TypeError, AttributeError or OverflowError means that a file is
    broken.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class JointWriter:
    """A format of people in 3D; the name of its entry point is the suffix of its files."""

    write: Callable[[Path, Array, Skeleton, Sequence[Array], str], None]
    """`write(path, times_s, skeleton, people, unit)`: write people's positions (times, joints, 3), y up."""
    one_person: bool = True
    """Whether a file has one person, so that each gets one in a folder of the format's name."""
    require: Callable[[], object] = lambda: None
    """Raise NotAvailableError without a package that it needs; the format is then left out."""


def load_readers() -> dict[str, JointReader]:
    """Import all readers, by name; one that fails is reported on stderr and skipped."""
    return load_plugins(READERS, *(one.name for one in fields(JointReader)))


def load_writers() -> dict[str, JointWriter]:
    """Import all writers, by name; one that fails is reported on stderr and skipped."""
    return load_plugins(WRITERS, *(one.name for one in fields(JointWriter)))


def bounded(*shape: int) -> tuple[int, ...]:
    """Return the shape of an array. Raises ValueError if the array has more than MAX_NUMBERS."""
    within(math.prod(shape), MAX_NUMBERS, "numbers")
    return shape


def number_in(name: str) -> int:
    """Return the last number in a file's or an image's name, without its suffix. Raises IndexError."""
    return int(re.findall(r"\d+", Path(name).stem)[-1])


def labels_of(frames: Mapping[int, Sequence[Array]], skeleton: Skeleton | None = None) -> Labels:
    """Return labels of individuals (joints, 3), each x, y and confidence, by the numbers of their frames.

    A joint of confidence 0 is unseen. Without a skeleton it is known by its number of joints, or has none.
    Raises ValueError if individuals differ in it.
    """
    joints = {len(one) for people in frames.values() for one in people}
    if len(joints) != 1:
        raise ValueError("its people have different numbers of joints" if joints else "it has no people")
    values = np.zeros(bounded(len(frames), max(map(len, frames.values())), *joints, 3))
    for row, (_, people) in zip(values, sorted(frames.items()), strict=True):
        row[: len(people)] = np.reshape(people, (-1, *row.shape[1:]))
    places = np.where(values[..., 2:] > 0, values[..., :2], np.nan)
    return Labels(skeleton or skeleton_of(*joints), sorted(frames), places, values[..., 2])


def rate_of(times_s: Array) -> float:
    """Return the mean rate of times, Hz; 1 for a single one."""
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0])) if len(times_s) > 1 else 1.0


@contextmanager
def opened_h5(path: Path) -> Iterator[Any]:
    """Open an H5 file. Raises BadInputError if it is broken, NotAvailableError if h5py is not installed."""
    h5py, data = load_optional("h5py", "people", "reading H5"), io.BytesIO(read_input(path))
    broken = OSError, RuntimeError, ArithmeticError, MemoryError
    with rejecting(f"{path} is not a readable H5 file", *broken), h5py.File(data, "r") as file:
        yield file
