"""Splats as other programs read them: gsply, and PlayCanvas's splat-transform."""

import csv
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from reconstruction.methods.splat.gaussians import (
    Gaussians,
    make_gaussians,
    read_splats,
    write_splats,
    write_spz,
)
from tests.project import ROOT
from tests.unit.reconstruction.depth.moments import moment

pytestmark = pytest.mark.filterwarnings("ignore")  # of numba, about this machine's libraries
PLY = "splat.ply"
SPLAT_TRANSFORM = shutil.which("splat-transform") or shutil.which(
    "splat-transform", path=str(ROOT / ".venv/readers/node_modules/.bin")
)
SPZ_STEP = 1 / 4096
"""Resolution of places in a .spz file, in the calibration's unit."""


@pytest.fixture
def splat(tmp_path: Path) -> Gaussians:
    write_splats(tmp_path / PLY, make_gaussians(moment()))
    return read_splats(tmp_path / PLY)


def test_gsply_reads_it_and_its_spz_keeps_the_places(splat: Gaussians, tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply", reason="gsply is not installed")
    shown = gsply.plyread(str(tmp_path / PLY))
    assert np.array_equal(shown.means, splat.places)
    assert np.allclose(np.exp(shown.scales), splat.sizes, rtol=1e-5)
    assert np.allclose(1 / (1 + np.exp(-shown.opacities.ravel())), splat.opacities, atol=1e-5)
    gsply.write_spz(str(tmp_path / "splat.spz"), shown)
    assert np.abs(gsply.read_spz(str(tmp_path / "splat.spz")).means - splat.places).max() <= SPZ_STEP


def test_gsply_reads_our_spz(splat: Gaussians, tmp_path: Path) -> None:
    """gsply leaves SPZ's axes as they are, right, up and back: half a turn about x from those of a .ply."""
    gsply = pytest.importorskip("gsply", reason="gsply is not installed")
    write_spz(tmp_path / "ours.spz", splat)
    ours, shown = gsply.read_spz(str(tmp_path / "ours.spz")), gsply.plyread(str(tmp_path / PLY))
    assert np.abs(ours.means * [1, -1, -1] - shown.means).max() < 1e-5
    assert np.abs(ours.scales - shown.scales).max() < 0.04
    assert np.abs(ours.sh0 - shown.sh0).max() < 0.02
    assert np.abs((ours.quats * [1, 1, -1, -1] * shown.quats).sum(axis=1)).min() > 0.99


@pytest.mark.skipif(SPLAT_TRANSFORM is None, reason="splat-transform is not installed")
def test_splat_transform_reads_it_and_writes_spz(splat: Gaussians, tmp_path: Path) -> None:
    for name in ("splat.csv", "splat.spz"):
        subprocess.run([SPLAT_TRANSFORM, tmp_path / PLY, tmp_path / name], check=True, capture_output=True)
    with (tmp_path / "splat.csv").open() as file:
        rows = list(csv.DictReader(file))
    places = np.array([[float(row[axis]) for axis in "xyz"] for row in rows])
    # It sorts the rows.
    assert np.allclose(np.sort(places, axis=0), np.sort(splat.places, axis=0), atol=1e-5)
    assert 0 < (tmp_path / "splat.spz").stat().st_size < (tmp_path / PLY).stat().st_size / 3
