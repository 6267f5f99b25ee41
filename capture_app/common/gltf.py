"""glTF 2.0 files: numbered lists, and arrays packed into one buffer."""

import base64
import json
import struct
from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.common.srgb import to_linear

_COMPONENTS = {"<f4": 5126, "<u4": 5125, "<u2": 5123}
_SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A glTF document to which items and arrays are appended."""

    def __init__(self) -> None:
        self._lists, self._data = defaultdict[str, list[dict[str, Any]]](list), bytearray()

    def add(self, kind: str, /, **item: Any) -> int:
        """Append an item to a list of the document, such as its nodes, and return its number there."""
        self._lists[kind].append(item)
        return len(self._lists[kind]) - 1

    def add_array(self, dtype: str, values: NDArray[Any], **facts: Any) -> int:
        """Append values (n or n x 1, 3, 4 or 16) to the buffer, and return the number of their accessor.

        `dtype`: how they are stored, <f4, <u4 or <u2; `facts`: further properties of the accessor.
        """
        table = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
        place = self.add("bufferViews", buffer=0, byteOffset=len(self._data), byteLength=table.nbytes)
        self._data += table.tobytes() + bytes(-table.nbytes % 4)
        return self.add(
            "accessors",
            bufferView=place,
            componentType=_COMPONENTS[dtype],
            count=len(table),
            type=_SHAPES[table.shape[1]],
            min=table.min(axis=0).tolist(),
            max=table.max(axis=0).tolist(),
            **facts,
        )

    def add_colours(self, levels: NDArray[np.uint8]) -> int:
        """Append vertex colours (n, 3; sRGB levels, 0 to 255), and return the number of their accessor."""
        # glTF's colours are linear light; 8 bits of it would show steps in the dark.
        light = np.full((len(levels), 4), 65535, "<u2")
        light[:, :3] = np.rint(65535 * to_linear(np.arange(256)))[levels]
        return self.add_array("<u2", light, normalized=True)

    def encode(self) -> bytes:
        """Return the file as JSON with the buffer inside (.gltf)."""
        return self._json(uri=f"data:application/octet-stream;base64,{base64.b64encode(self._data).decode()}")

    def encode_binary(self) -> bytes:
        """Return the file in its binary form (.glb)."""
        head, size = self._json(), len(self._data)
        head += b" " * (-len(head) % 4)
        begin = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(head) + size, len(head), b"JSON")
        return b"".join([begin, head, struct.pack("<I4s", size, b"BIN\0"), self._data])

    def _json(self, **address: str) -> bytes:
        asset, buffer = (
            {"version": "2.0", "generator": "simulshot"},
            {"byteLength": len(self._data), **address},
        )
        return json.dumps({"asset": asset, "scene": 0, "buffers": [buffer], **self._lists}).encode()
