"""Cheap units for the tests of batches, and a batch of them that can be killed.

`python -m tests.unit.reconstruction.methods.batch.fake_units OUT SESSION` makes all its units in three
conditions, with I/N those of a shard, with `summary` only the summary, and with `real` the depth of one.
"""

import errno
import os
import signal
import sys
from pathlib import Path

from reconstruction.methods.batch.units import Unit
from reconstruction.scene.conditions import Condition

FAKE_TASK = "tests.unit.reconstruction.methods.batch.fake_units:compute"
LOG = "FAKE_UNITS_LOG"
CONDITIONS = ("synced", "33", "66")
BLOCKS = 20


def compute(unit: Unit, folder: Path) -> None:
    """Files whose bytes follow from the key, with a line in the log when it begins and when it ends."""
    _log(f"begin {unit.key}")
    (folder / "depth").mkdir()
    for k in range(BLOCKS):
        (folder / "depth" / f"{k}.bin").write_bytes(unit.key.encode() * 1000 * (k + 1))
    (folder / "unit.json").write_text('{"coverage": 0.5}\n')
    _log(f"end {unit.key}")


def compute_or_fail(unit: Unit, folder: Path) -> None:
    """Fails in another way at every instant but the last."""
    if unit.instant == 0:
        raise ValueError("unheard of\nin two lines")
    if unit.instant == 1:
        os.kill(os.getpid(), signal.SIGSEGV)
    if unit.instant == 2:
        (folder / "half").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    if unit.instant == 3:
        raise MemoryError
    compute(unit, folder)


def refuse_synchronized(unit: Unit, folder: Path) -> None:
    """No depth can be made of synchronized pictures of the first instant."""
    if unit.condition == "synced" and unit.instant == 0:
        (folder / "unit.json").write_text('{"not_applicable": "nothing to calibrate from"}\n')
    else:
        compute(unit, folder)


def _log(line: str) -> None:
    if LOG in os.environ:
        with Path(os.environ[LOG]).open("a") as file:
            file.write(line + "\n")


def main() -> None:
    """Run a batch of the units, or of real ones where a third argument asks for it."""
    from reconstruction.methods.batch.batch_plan import DEPTH_TASK, BatchPlan
    from reconstruction.methods.batch.batch_run import batch, summarize
    from reconstruction.methods.batch.units import Shard
    from reconstruction.methods.batch.workers import Workers

    out, session, *asked = sys.argv[1:]
    conditions = tuple(Condition.parse(text) for text in (("synced",) if "real" in asked else CONDITIONS))
    # Whoever edits the program while a test runs computes no new units.
    options = BatchPlan(conditions=conditions, program="fixed")
    task = DEPTH_TASK if "real" in asked else FAKE_TASK
    shard = next((Shard.parse(text) for text in asked if "/" in text), None)
    try:
        if "summary" in asked:
            summarize([Path(session)], Path(out), options)
        else:
            batch([Path(session)], Path(out), options, Workers(jobs=2), task, shard)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
