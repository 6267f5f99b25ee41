"""People as a glTF 2.0 that moves, for Blender and browsers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.gltf import Gltf
from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointWriter
from reconstruction.methods.people.skeletons import Skeleton

BONE_WIDTH = 0.1
"""Width of a bone, relative to the median length of bones."""
NO_BONES = 0.02
"""Width of a joint without bones, in the calibration's unit."""
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
TRIANGLES = FACES[:, [0, 1, 2, 0, 2, 3]].ravel()
"""A box: its corners, the first four at its first joint, and their numbers around each side."""


def write(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Array], unit: str) -> None:
    """Write people, positions (times, joints, 3) with y up, as a glTF 2.0 whose bones move.

    Each joint is a node; a person's mesh has a box a bone, whose ends move with its joints. A joint, or a
    person, that is never known is left out; in a gap a joint waits where it was.
    """
    document, nodes, paths = Gltf(), list[int](), dict[int, int]()
    times = document.add_array("<f4", times_s)
    for number, positions in enumerate(people, 1):
        if np.isfinite(positions).any():
            surface, moved = _add_person(document, f"person{number}", skeleton, positions)
            nodes += *moved, surface
            paths |= moved
    document.add("scenes", **({"nodes": nodes} if nodes else {}))
    if paths:
        document.add(
            "animations",
            samplers=[{"input": times, "output": path} for path in paths.values()],
            channels=[
                {"sampler": k, "target": {"node": node, "path": "translation"}}
                for k, node in enumerate(paths)
            ],
        )
    write_atomic(path, document.encode())


def _add_person(
    document: Gltf, name: str, skeleton: Skeleton, positions: Array
) -> tuple[int, dict[int, int]]:
    """Add a person's joints, mesh and skin; return the mesh's node, and each joint's node with its path."""
    known = np.isfinite(positions[..., 0])
    joints, moved = np.flatnonzero(known.any(axis=0)).tolist(), dict[int, int]()
    for k in joints:
        at = np.flatnonzero(known[:, k])
        path = positions[at[np.searchsorted(at, np.arange(len(known)), "right").clip(1) - 1], k]
        node = document.add("nodes", name=f"{name}_{skeleton.joints[k]}", translation=path[0].tolist())
        moved[node] = document.add_array("<f4", path)
    bones = [(a, b) for a, b in skeleton.bones if (known[:, a] & known[:, b]).any()]
    lengths = [np.linalg.norm(positions[:, a] - positions[:, b], axis=1) for a, b in bones]
    width = BONE_WIDTH * float(np.nanmedian(lengths)) if bones else NO_BONES
    ends = np.searchsorted(joints, bones or [(k, k) for k in joints])
    influence = np.zeros((len(ends) * len(CORNERS), 4))
    influence[:, 0] = ends.repeat(4)
    indices = (TRIANGLES + len(CORNERS) * np.arange(len(ends))[:, None]).reshape(-1, 1)
    surface = {
        "attributes": {
            "POSITION": document.add_array("<f4", np.tile(CORNERS * (width / 2), (len(ends), 1))),
            "JOINTS_0": document.add_array("<u2", influence),
            "WEIGHTS_0": document.add_array("<f4", np.tile([1, 0, 0, 0], (len(influence), 1))),
        },
        "indices": document.add_array("<u4", indices),
    }
    still = document.add_array("<f4", np.tile(np.eye(4).ravel(), (len(joints), 1)))
    skin = document.add("skins", joints=[*moved], inverseBindMatrices=still)
    mesh = document.add("meshes", primitives=[surface])
    return document.add("nodes", name=name, mesh=mesh, skin=skin), moved


WRITER = JointWriter(write=write, one_person=False)
