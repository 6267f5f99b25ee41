"""The folder of a comparison: metrics, report, pictures, and the stages that the next one uses again."""

from pathlib import Path

import msgspec

from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import OutputFolder, replaces_only
from capture_app.text import pretty_json

METRICS = "metrics.json"
STAGES = "stages"
OURS = {METRICS, "report.html", "pictures", "depth.tiff", "depth_filled.tiff", STAGES}


def comparison_folder(out: Path) -> OutputFolder:
    """A folder that takes the place of an earlier comparison at `out`, and begins with its stages.

    Raises:
        BadInputError: there is something else at `out`.
    """
    return OutputFolder(out, replaces_only(OURS), reuse=STAGES)


def write_metrics(folder: Path, result: msgspec.Struct) -> None:
    """Write what was measured into a comparison's folder."""
    write_atomic(folder / METRICS, pretty_json(result))
