"""People as a glTF 2.0 that moves, for Blender and browsers."""

import base64
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.skeletons import Skeleton

COMPONENTS = {"<f4": 5126, "<u4": 5125, "<u2": 5123}
"""glTF's numbers of the types of values."""
BONE_WIDTH = 0.1
"""Width of a bone, relative to the median length of bones."""
NO_BONES = 0.02
"""Width of a joint without bones, in the calibration's unit."""
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
TRIANGLES = SIDES[:, [0, 1, 2, 0, 2, 3]].ravel()
"""A box: its corners, the first four at its first joint, and their numbers around each side."""


def write_gltf(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Array]) -> None:
    """Write people, positions (times, joints, 3) with y up, as a glTF 2.0 whose bones move.

    Each joint is a node; a person's mesh has a box a bone, whose ends move with its joints. A joint that is
    never known is left out; in a gap it waits where it was.
    """
    document = _Gltf()
    times = document.add("<f4", times_s, "SCALAR")
    for number, positions in enumerate(people, 1):
        document.add_person(f"person{number}", times, skeleton, positions)
    write_atomic(path, document.encoded())


class _Gltf:
    """A glTF document and its binary buffer."""

    def __init__(self) -> None:
        self._data, self._lists = bytearray(), defaultdict[str, list[Any]](list)

    def add(self, kind: str, values: Array, shape: str) -> int:
        """Append an array, and return the number of its accessor."""
        table = values.astype(kind).reshape(len(values), -1)
        place = {"buffer": 0, "byteOffset": len(self._data), "byteLength": table.nbytes}
        self._lists["bufferViews"].append(place)
        self._data += table.tobytes() + bytes(-table.nbytes % 4)
        return self._append("accessors", {
            "bufferView": len(self._lists["accessors"]),
            "componentType": COMPONENTS[kind],
            "count": len(values),
            "type": shape,
            "min": table.min(axis=0).tolist(),
            "max": table.max(axis=0).tolist(),
        })  # fmt: skip

    def _append(self, name: str, one: dict[str, Any]) -> int:
        """Append to a list of the document, and return its number there."""
        self._lists[name].append(one)
        return len(self._lists[name]) - 1

    def add_person(self, name: str, times: int, skeleton: Skeleton, positions: Array) -> None:
        """Add the joints, mesh, skin and motion of one person, by the accessor of the times."""
        known = np.isfinite(positions[..., 0])
        joints, nodes = np.flatnonzero(known.any(axis=0)).tolist(), list[int]()
        for k in joints:
            at = np.flatnonzero(known[:, k])
            path = positions[at[np.searchsorted(at, np.arange(len(known)), "right").clip(1) - 1], k]
            node = {"name": f"{name}_{skeleton.joints[k]}", "translation": path[0].tolist()}
            nodes.append(self._append("nodes", node))
            sampler = self._append("samplers", {"input": times, "output": self.add("<f4", path, "VEC3")})
            target = {"node": nodes[-1], "path": "translation"}
            self._append("channels", {"sampler": sampler, "target": target})
        bones = [bone for bone in skeleton.bones if {*bone} <= {*joints}]
        lengths = [np.linalg.norm(positions[:, a] - positions[:, b], axis=1) for a, b in bones]
        width = BONE_WIDTH * float(np.nanmedian(lengths)) if bones else NO_BONES
        ends = np.searchsorted(joints, bones or [(k, k) for k in joints])
        influence = np.zeros((len(ends) * len(CORNERS), 4))
        influence[:, 0] = ends.repeat(4)
        indices = (TRIANGLES + len(CORNERS) * np.arange(len(ends))[:, None]).ravel()
        surface = {
            "attributes": {
                "POSITION": self.add("<f4", np.tile(CORNERS * (width / 2), (len(ends), 1)), "VEC3"),
                "JOINTS_0": self.add("<u2", influence, "VEC4"),
                "WEIGHTS_0": self.add("<f4", np.tile([1, 0, 0, 0], (len(influence), 1)), "VEC4"),
            },
            "indices": self.add("<u4", indices, "SCALAR"),
        }
        still = self.add("<f4", np.tile(np.eye(4).ravel(), (len(joints), 1)), "MAT4")
        skin = self._append("skins", {"joints": nodes, "inverseBindMatrices": still})
        mesh = self._append("meshes", {"primitives": [surface]})
        self._append("nodes", {"name": name, "mesh": mesh, "skin": skin})

    def encoded(self) -> bytes:
        """Return the document as JSON with its buffer inside."""
        address = f"data:application/octet-stream;base64,{base64.b64encode(self._data).decode()}"
        content = {
            "asset": {"version": "2.0", "generator": "simulshot"},
            "scene": 0,
            "scenes": [{"nodes": [*range(len(self._lists["nodes"]))]}],
            "animations": [{name: self._lists.pop(name) for name in ("samplers", "channels")}],
            "buffers": [{"byteLength": len(self._data), "uri": address}],
            **self._lists,
        }
        return json.dumps(content).encode()
