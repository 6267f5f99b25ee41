"""DeepLabCut's tables, CSV or H5, of one animal or of several, after its `analyze_videos`."""

import csv
import io
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.session.files.untrusted_files import check_pickle, read_text
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointReader, Labels, bounded, number_in, opened_h5
from reconstruction.methods.people.skeletons import Skeleton

_LEVELS = ("scorer", "individuals", "bodyparts", "coords")


def read(files: Sequence[Path]) -> Labels | None:
    """Return the labels of a table; None if it is not DeepLabCut's."""
    return (_read_h5 if files[0].suffix.lower() == ".h5" else _read_csv)(files[0])


def _read_csv(path: Path) -> Labels | None:
    rows = [row for row in csv.reader(io.StringIO(read_text(path))) if row]
    levels = {row[0]: row for row in rows if row[0] in _LEVELS}
    if "coords" not in levels:
        return None
    first = levels["coords"].index("x")
    heads = [levels.get(level, [""] * len(rows[0]))[first:] for level in _LEVELS[1:]]
    body = rows[len(levels) :]
    # A row of labels by hand begins with its image's folder and name.
    numbers = [number_in("".join(row[:first])) for row in body]
    values = np.array([[value or "nan" for value in row[first:]] for row in body], float)
    return _labels([*zip(*heads, strict=True)], numbers, values)


def _read_h5(path: Path) -> Labels | None:
    with opened_h5(path) as file:
        table = next(
            (group["table"] for group in file.values() if isinstance(group, Mapping) and "table" in group),
            None,
        )
        if table is None:
            return None
        bounded(len(table), table.dtype.itemsize)
        axes = bytes(file[table.parent.name].attrs["non_index_axes"])
        check_pickle(axes)
        (_, columns), *_ = _Plain(io.BytesIO(axes)).load()
        named = [("", *column[1:])[-3:] if len(column) == 3 else tuple(column[1:]) for column in columns]
        parts = [table[name] for name in table.dtype.names if name.startswith("values")]
        values = np.concatenate([part.reshape(len(table), -1) for part in parts], axis=1)
        return _labels(named, table["index"].tolist(), values)


class _Plain(pickle.Unpickler):
    """Unpickler of lists, tuples and texts; anything else could run code."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"it names {module}.{name}")


def _labels(columns: Sequence[Sequence[str]], numbers: Sequence[int], values: Array) -> Labels:
    """Return labels of columns (individual, joint, x|y|likelihood), by the frames of the rows."""
    names, joints = (list(dict.fromkeys(column[level] for column in columns)) for level in (0, 1))
    table = np.full(bounded(len(numbers), len(names), len(joints), 3), np.nan)
    table[..., 2] = 1.0
    for (name, joint, coordinate), column in zip(columns, values.T, strict=True):
        axis = ("x", "y", "likelihood").index(coordinate)
        table[:, names.index(name), joints.index(joint), axis] = column
    skeleton = Skeleton(tuple(joints), ())
    return Labels(skeleton, numbers, table[..., :2], np.nan_to_num(table[..., 2]), tuple(names))


READER = JointReader(program="DeepLabCut", suffixes=(".csv", ".h5"), read=read)
