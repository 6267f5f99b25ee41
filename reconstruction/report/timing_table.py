"""How late each camera of a rig is, as a table of a page."""

from reconstruction.report import wording
from reconstruction.report.tables import Cell, Column, Row, Table
from reconstruction.report.timing_words import rig_judgement, rig_lateness
from reconstruction.scores.timing import RigTiming


def timing_table(rig: RigTiming) -> Table:
    """Every camera against the reference, by what moves: its lateness, and what follows from it."""
    rows = [
        Row(one.other, [Cell(rig_lateness(one) or wording.NOT_AVAILABLE), Cell(rig_judgement(one))])
        for one in rig.cameras
    ]
    return Table(
        f"When the cameras took their pictures, against {rig.reference}, by what moves; 95 %",
        [Column("Against it"), Column("Judged as")],
        rows,
        first="Camera",
    )
