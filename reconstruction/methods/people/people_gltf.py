"""People as a glTF 2.0 that moves, for Blender and browsers."""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.skeletons import Skeleton

_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
LISTS = ("nodes", "meshes", "skins", "accessors", "bufferViews")
BONE_WIDTH = 0.1
"""Width of a bone, relative to the median length of bones."""
NO_BONES = 0.02
"""Width of a joint without bones, in the calibration's unit."""


def write_gltf(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Array]) -> None:
    """Write people, positions (times, joints, 3) with y up, as a glTF 2.0 whose bones move.

    Each joint is a node; a person's mesh has a box a bone, whose ends move with its joints. A joint that is
    never known is left out; in a gap it waits where it was.
    """
    document = _Gltf()
    for number, positions in enumerate(people, 1):
        document.add_person(f"person{number}", times_s, skeleton, positions)
    write_atomic(path, document.encoded())


class _Gltf:
    """A glTF document and its binary buffer."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._lists = {name: list[Any]() for name in LISTS}
        self._roots = list[int]()
        self._motion: dict[str, list[Any]] = {"samplers": [], "channels": []}

    def _add(self, values: Array, kind: str, component: int) -> int:
        """Append an array, and return the number of its accessor."""
        self._lists["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self._data), "byteLength": values.nbytes}
        )
        self._data += values.tobytes()
        self._data += bytes(-len(self._data) % 4)
        flat = values.reshape(len(values), -1)
        self._lists["accessors"].append({
            "bufferView": len(self._lists["bufferViews"]) - 1,
            "componentType": component,
            "count": len(values),
            "type": kind,
            "min": flat.min(axis=0).tolist(),
            "max": flat.max(axis=0).tolist(),
        })  # fmt: skip
        return len(self._lists["accessors"]) - 1

    def add_person(self, name: str, times_s: Array, skeleton: Skeleton, positions: Array) -> None:
        """Add the joints, mesh, skin and motion of one person."""
        joints = [k for k in range(len(skeleton.joints)) if np.isfinite(positions[:, k, 0]).any()]
        bones = [(joints.index(a), joints.index(b)) for a, b in skeleton.bones if a in joints and b in joints]
        first = len(self._lists["nodes"])
        times = self._add(times_s.astype("<f4"), "SCALAR", _FLOAT)
        for k in joints:
            known = np.nonzero(np.isfinite(positions[:, k, 0]))[0]
            held = known[np.clip(np.searchsorted(known, np.arange(len(times_s)), "right") - 1, 0, None)]
            path = positions[held, k].astype("<f4")
            target = {"node": len(self._lists["nodes"]), "path": "translation"}
            self._motion["channels"].append({"sampler": len(self._motion["samplers"]), "target": target})
            self._motion["samplers"].append({"input": times, "output": self._add(path, "VEC3", _FLOAT)})
            self._lists["nodes"].append(
                {"name": f"{name}_{skeleton.joints[k]}", "translation": path[0].tolist()}
            )
        lengths = [
            np.linalg.norm(positions[:, joints[a]] - positions[:, joints[b]], axis=1) for a, b in bones
        ]
        width = BONE_WIDTH * float(np.nanmedian(np.concatenate(lengths))) if bones else NO_BONES
        mesh = self._mesh(bones or [(k, k) for k in range(len(joints))], width)
        identity = np.tile(np.eye(4, dtype="<f4").ravel(), (len(joints), 1))
        self._lists["skins"].append({
            "joints": list(range(first, first + len(joints))),
            "inverseBindMatrices": self._add(identity, "MAT4", _FLOAT),
        })  # fmt: skip
        self._roots += [*range(first, len(self._lists["nodes"]) + 1)]
        self._lists["nodes"].append({"name": name, "mesh": mesh, "skin": len(self._lists["skins"]) - 1})

    def _mesh(self, bones: Sequence[tuple[int, int]], width: float) -> int:
        """Add boxes around bones (joint, joint): each corner is at its joint, plus a step aside."""
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (width / 2)
        faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
        places = np.tile(corners, (len(bones), 1)).astype("<f4")
        owners = np.array([[a, b] for a, b in bones])[:, [0, 0, 0, 0, 1, 1, 1, 1]].reshape(-1, 1)
        indices = (triangles[None] + 8 * np.arange(len(bones))[:, None, None]).reshape(-1).astype("<u4")
        influence = np.zeros((len(owners), 4), "<u2")
        influence[:, :1] = owners
        weights = np.zeros((len(owners), 4), "<f4")
        weights[:, 0] = 1
        attributes = {
            "POSITION": self._add(places, "VEC3", _FLOAT),
            "JOINTS_0": self._add(influence, "VEC4", _USHORT),
            "WEIGHTS_0": self._add(weights, "VEC4", _FLOAT),
        }
        self._lists["meshes"].append(
            {"primitives": [{"attributes": attributes, "indices": self._add(indices, "SCALAR", _UINT)}]}
        )
        return len(self._lists["meshes"]) - 1

    def encoded(self) -> bytes:
        """Return the document as JSON with its buffer inside."""
        address = f"data:application/octet-stream;base64,{base64.b64encode(self._data).decode()}"
        content = {
            "asset": {"version": "2.0", "generator": "simulshot"},
            "scene": 0,
            "scenes": [{"nodes": self._roots}],
            **{name: values for name, values in self._lists.items() if values},
            **({"animations": [self._motion]} if self._motion["channels"] else {}),
            **({"buffers": [{"byteLength": len(self._data), "uri": address}]} if self._data else {}),
        }
        return json.dumps(content).encode()
