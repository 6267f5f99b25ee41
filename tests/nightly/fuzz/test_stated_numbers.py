"""Every length, rate, count and offset that a file or a machine states, exchanged: no error, no memory."""

import random
import shutil
from pathlib import Path

import pytest

from tests.fuzz.readers import READERS
from tests.fuzz.stated_numbers import restated
from tests.project import ROOT

MAX_CHANGES, MAX_BYTES = 1500, 500_000_000
"""Changes tried of each file of the corpus, drawn where it has more, and the memory that none may take."""
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
FILES = [file.relative_to(CORPUS) for file in sorted(CORPUS.glob("*/*"))]


def memory_bytes(field: str) -> int:
    """Return this process's resident memory (VmRSS), or its peak since the last reset (VmHWM)."""
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith(field))


@pytest.mark.parametrize("file", FILES, ids=str)
def test_a_number_that_cannot_be_is_refused(file: Path, tmp_path: Path) -> None:
    changes = [*restated((CORPUS / file).read_bytes())]
    if len(changes) > MAX_CHANGES:
        changes = random.Random(str(file)).sample(changes, MAX_CHANGES)
    Path("/proc/self/clear_refs").write_text("5")
    before = memory_bytes("VmRSS")
    for number, data in enumerate(changes):
        folder = tmp_path / str(number)
        folder.mkdir()
        try:
            READERS[file.parts[0]](data, folder)
        except Exception as error:
            error.add_note(f"{file}, change {number}: {data[:2000]!r}")
            raise
        shutil.rmtree(folder)
        assert memory_bytes("VmHWM") - before < MAX_BYTES, f"change {number}: {data[:2000]!r}"
