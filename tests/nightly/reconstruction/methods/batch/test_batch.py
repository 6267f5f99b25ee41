"""`reconstruct batch`: its units, what it does with those that fail, and its summary."""

import json
from pathlib import Path

from capture_app.session.reading.reader import Session
from tests.unit.reconstruction.conftest import Reconstruct


def test_shards_make_the_same_splats_as_one_command(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    asked, alone = ("batch", boards.folder, "--instants", "2-3", "--splats"), ("--jobs", 1)
    assert reconstruct(*asked, *alone, "--out", tmp_path / "whole").code == 0
    for extra in ((*alone, "--shard", "1/2"), (*alone, "--shard", "2/2"), ("--summary",)):
        assert reconstruct(*asked, *extra, "--out", tmp_path / "parts").code == 0
    whole, parts = (
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file() and "work" not in path.parts
        }
        for name in ("whole", "parts")
    )
    assert whole == parts
    records = [json.loads(data)["splat"] for path, data in whole.items() if path.name == "unit.json"]
    assert len(records) == 2
    assert all(record["gaussians"] > 1000 and record["psnr"] > 20 for record in records)
    assert sum(path.name == "splat.ply" for path in whole) == 2
