"""`reconstruct compare`: the effect of synchronization on depth, panorama and poses of one burst."""

import time
from pathlib import Path

import msgspec

from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.compare.comparison import CompareOptions, Comparison
from reconstruction.report.comparison_report import write_report
from reconstruction.scores.compare_results import CompareResult
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import nearest_frame_offset


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder appears whole or not at all.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used.
    """
    began = time.monotonic()
    dataset = Dataset.open(session)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    with comparison_folder(out) as output:
        result = Comparison(dataset, offset, options, output.folder).run_studies(session)
        result = msgspec.structs.replace(result, report="report.html", seconds=time.monotonic() - began)
        write_report(result, output.folder)
        write_metrics(output.folder, result)
    return result
