"""Counts what the board covers in previews, which come one by one and not quite at one moment."""

from collections.abc import Mapping

import cv2
import numpy as np

from capture_app.board.coverage import BoardCoverage, CoverageCount
from capture_app.board.detector import Board, BoardDetector, Corners

MOMENT_NS = 300_000_000
"""Previews that are less apart than this are of one moment: the board is moved by hand."""


class PreviewCount:
    """The coverage of a rig by its previews, whatever their size."""

    def __init__(self, board: Board, sizes: Mapping[str, tuple[int, int]]) -> None:
        """`sizes`: width and height of each camera's full pictures, px."""
        self._sizes = dict(sizes)
        self._count = CoverageCount(board, sizes)
        self._detectors = {name: BoardDetector(board) for name in sizes}
        self._latest: dict[str, tuple[int, Corners]] = {}

    def add(self, camera: str, leader_ns: int | None, jpeg: bytes) -> BoardCoverage:
        """Count one preview and return what is covered; `leader_ns`: its time, None where it is not known."""
        grey = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        if grey is not None and camera in self._sizes:
            scale = np.array(self._sizes[camera]) / grey.shape[::-1]
            found = self._detectors[camera].detect(grey)
            corners = {number: (at + 0.5) * scale - 0.5 for number, at in found.items()}
            others = {}
            if leader_ns is not None:
                others = {
                    name: seen
                    for name, (at_ns, seen) in self._latest.items()
                    if name != camera and abs(at_ns - leader_ns) < MOMENT_NS
                }
                self._latest[camera] = leader_ns, corners
            self._count.add({camera: corners}, others)
        return self._count.coverage()
