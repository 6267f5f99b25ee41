"""SLEAP's analysis H5 of one video, after `sleap.io.convert`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from reconstruction.methods.people.joint_formats import JointReader, Labels, bounded, opened_h5
from reconstruction.methods.people.skeletons import Skeleton


def read(files: Sequence[Path]) -> Labels | None:
    """Return the labels of an analysis, whose `tracks` are (tracks, 2, nodes, frames); None for others."""
    with opened_h5(files[0]) as file:
        if "tracks" not in file or "node_names" not in file:
            return None
        nodes = [name.decode() for name in file["node_names"][:]]
        bounded(*file["tracks"].shape)
        tracks = file["tracks"][:].transpose(3, 0, 2, 1)
        seen, has_scores = np.isfinite(tracks).all(axis=3), "point_scores" in file
        scores = file["point_scores"][:].transpose(2, 0, 1) if has_scores else np.ones(seen.shape)
        # Points that a person has corrected have no score.
        confidence = np.where(seen, np.where(np.nan_to_num(scores) > 0, scores, 1.0), 0)
        bones = tuple((int(a), int(b)) for a, b in file["edge_inds"][:]) if "edge_inds" in file else ()
        names = tuple(name.decode() for name in file["track_names"][:]) if len(file["track_names"]) else ("",)
        return Labels(Skeleton(tuple(nodes), bones), range(len(tracks)), tracks, confidence, names)


READER = JointReader(program="SLEAP", suffixes=(".h5",), read=read)
