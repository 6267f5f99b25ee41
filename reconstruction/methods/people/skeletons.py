"""Skeletons: the names of joints, and the bones between them."""

import tomllib
from importlib.resources import files
from typing import NamedTuple, Self


class Skeleton(NamedTuple):
    """Names of joints in order, and pairs of joints, by number, that a bone joins."""

    joints: tuple[str, ...]
    bones: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, joints: list[str], bones: list[list[str]]) -> Self:
        """Return a skeleton whose bones name their joints."""
        return cls(tuple(joints), tuple((joints.index(a), joints.index(b)) for a, b in bones))


SKELETONS = {
    name: Skeleton.of(**skeleton)
    for name, skeleton in tomllib.loads(
        files(__package__).joinpath("skeletons.toml").read_text("utf-8")
    ).items()
}
"""The skeletons of `skeletons.toml` by name."""


def skeleton_of(joints: int) -> Skeleton:
    """Return the known skeleton of so many joints, or one of numbered joints without bones."""
    known = {len(skeleton.joints): skeleton for skeleton in SKELETONS.values()}
    return known.get(joints) or Skeleton(tuple(f"joint{k}" for k in range(1, joints + 1)), ())
