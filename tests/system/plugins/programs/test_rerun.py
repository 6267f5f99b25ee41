"""Exports read by Rerun; skipped where it is not installed (`make readers`)."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit.plugins.programs.conftest import Export, Make

pytest.importorskip("rerun", reason="make readers: rerun-sdk is not installed")


def test_rerun_reads_it(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "rrd")
    path = tmp_path / "out" / "clap.rrd"
    said = _rerun("rrd", "print", "-v", str(path))
    assert "rig/left" in said
    assert "Pinhole:image_from_camera" in said
    assert "EncodedImage:blob" in said


def test_rerun_converts_the_mcap(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "mcap")
    converted = tmp_path / "clap.rrd"
    _rerun("mcap", "convert", str(tmp_path / "out" / "clap.mcap"), "-o", str(converted))
    said = _rerun("rrd", "print", "-v", str(converted))
    assert "EncodedImage:blob" in said
    assert "Pinhole:image_from_camera" in said
    assert "Transform3D:quaternion" in said


def _rerun(*arguments: str) -> str:
    command = [sys.executable, "-m", "rerun", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
