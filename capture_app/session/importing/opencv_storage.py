"""Reader for YAML and XML files of OpenCV's cv2.FileStorage.

It does not use OpenCV, whose parser suffers memory corruption on malformed files. The format follows the
documentation of FileStorage: a map of names to numbers, texts, lists and matrices. A matrix has rows, cols
(or sizes), dt (number of channels, then a letter for the type) and data.
"""

import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input, rejecting, within
from capture_app.session.format.lens import Array

MAX_BYTES, MAX_NODES, MAX_SCALAR = 150_000, 12_000, 1 << 16
"""Maximum size of a file, bytes; of YAML values, counted again at each alias; and of one value, letters.

A calibration has some kilobytes, even with all points it was computed from. PyYAML takes up to 15 s a
MiB, far more where anchors refer to anchors; and several importers look at one file.
"""
_MATRICES = "opencv-matrix", "opencv-nd-matrix"
_DTYPE = re.compile(r"(\d*)[a-z]")


def read_storage(path: Path, *, hint: str = "write it again, as with OpenCV's FileStorage") -> dict[str, Any]:
    """Read a file's values by name: matrices as float64 rows x columns (x channels), numbers, texts, lists.

    Raises BadInputError if the file cannot be read or is not in this format.
    """
    data = read_input(path, max_bytes=MAX_BYTES)
    with rejecting(
        f"cannot read {path}",
        *(yaml.YAMLError, ET.ParseError, LookupError, ValueError, OverflowError, RecursionError),
        hint=hint,
    ):
        content = _read_xml(data) if path.suffix.lower() == ".xml" else _read_yaml(data)
        if not isinstance(content, dict):
            raise ValueError("it is not a list of names and values")
    return {str(key): value for key, value in content.items()}


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the values of a YAML file by name, as `read_storage` does; none if it is not one."""
    if path.is_file() and path.suffix.lower() in (".yaml", ".yml"):
        with suppress(BadInputError):
            return read_storage(path)
    return {}


class _Loader(yaml.SafeLoader):
    """YAML loader with OpenCV's matrices, and a limit on all values, however often an alias repeats them."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._total, self._counts = 0, dict[yaml.Node | None, int]()
        """Number of all values, and of each node's, its own and those below it."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose the next node. Raises ValueError if the file exceeds the limits."""
        is_alias, before = self.check_event(yaml.AliasEvent), self._total
        node = super().compose_node(parent, index)
        # What contains its own alias has no end, and no count yet.
        self._total += self._counts.get(node, MAX_NODES) if is_alias else 1
        self._counts.setdefault(node, self._total - before)
        within(self._total, MAX_NODES, "values")
        within(len(getattr(node, "value", "")), MAX_SCALAR, "letters in a value")
        return node


def _yaml_matrix(loader: _Loader, node: yaml.Node) -> Array:
    if not isinstance(node, yaml.MappingNode):
        raise ValueError("a matrix is not a map")
    return _matrix(loader.construct_mapping(node, deep=True))


for name in _MATRICES:
    _Loader.add_constructor(f"tag:yaml.org,2002:{name}", _yaml_matrix)


def _read_yaml(data: bytes) -> Any:
    # OpenCV writes %YAML:1.0, whose colon is not valid YAML.
    text = data.decode("utf-8-sig")
    # `rostopic echo` ends each message with the line that begins the next one.
    return next(yaml.load_all(text.partition("\n")[2] if text.startswith("%YAML") else text, _Loader), None)


def _read_xml(data: bytes) -> Any:
    root = ET.fromstring(data)  # noqa: S314 - no entity is resolved from elsewhere, and the size is bounded
    if root.tag != "opencv_storage":
        raise ValueError("it is not OpenCV's XML")
    return {element.tag: _xml_value(element) for element in root}


def _xml_value(element: ET.Element) -> Any:
    if element.get("type_id") in _MATRICES:
        return _matrix({part.tag: (part.text or "").strip() for part in element})
    if len(element):
        items = [_xml_value(part) for part in element]
        return items if all(part.tag == "_" for part in element) else dict(zip(element, items, strict=True))
    text = (element.text or "").strip()
    try:
        return float(text)
    except ValueError:
        return text.strip('"')


def _matrix(parts: dict[Any, Any]) -> Array:
    sizes = _items(parts.get("sizes")) if "sizes" in parts else [parts.get("rows"), parts.get("cols")]
    dtype = _DTYPE.fullmatch(str(parts.get("dt", "")))
    if dtype is None or None in sizes or "data" not in parts:
        raise ValueError("a matrix lacks its size, dt or data")
    shape = [*(int(str(size)) for size in sizes), *([int(dtype[1])] if dtype[1] else [])]
    values = np.array([float(str(item)) for item in _items(parts["data"])], np.float64)
    if min(shape) < 0 or math.prod(shape) != len(values):
        raise ValueError(f"a matrix has {len(values)} numbers, not {' x '.join(map(str, shape))}")
    return values.reshape(shape)


def _items(value: Any) -> list[Any]:
    return value.split() if isinstance(value, str) else value if isinstance(value, list) else [value]
