"""Each reader over its corpus, and over changes of it that are the same every time."""

import random
from pathlib import Path

import pytest

from tests.fuzz.mutations import mutate
from tests.fuzz.readers import READERS
from tests.project import ROOT

CORPUS = ROOT / "tests/fuzz/corpus"
CHANGES = 15


def test_every_corpus_has_a_reader() -> None:
    assert {folder.name for folder in CORPUS.iterdir()} == set(READERS)


@pytest.mark.parametrize("reader", READERS)
def test_nothing_but_what_users_are_told(reader: str, tmp_path: Path) -> None:
    rng = random.Random(reader)
    kept = [file.read_bytes() for file in sorted((CORPUS / reader).iterdir())]
    for number, data in enumerate([b"", *kept, *(mutate(rng.choice(kept), rng) for _ in range(CHANGES))]):
        folder = tmp_path / str(number)
        folder.mkdir()
        try:
            READERS[reader](data, folder)
        except Exception as error:
            error.add_note(f"{reader}, input {number}: {data[:2000]!r}")
            raise
