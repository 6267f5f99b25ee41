"""A lens is the same lens through every door: each of our files, read by each of its readers."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from capture_app.session.format.calibration import Calibration, CameraCalibration, LensKnowledge
from capture_app.session.format.calibration_judge import camera_fault
from capture_app.session.format.export_record import RECORD, ExportRecord, read_record
from capture_app.session.format.lens import rays_of
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.reading.array_access import open_session
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.stored import camera_modes, find_calibration, keep_calibration
from reconstruction.scene.calibration_run import read_calibration
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import Scene, make_view, write_session

RIG = {"left": make_view((-0.1, 0.0, 0.0)), "right": make_view((0.1, 0.0, 0.0))}
SIZE = RIG["left"].width, RIG["left"].height
GRID = np.stack(np.meshgrid(*(np.linspace(-0.5, side - 0.5, 9) for side in SIZE)), axis=-1).reshape(-1, 2)


def numbers(most: float) -> st.SearchStrategy[float]:
    return st.integers(-1000, 1000).map(lambda part: most * part / 1000)


@st.composite
def lenses(draw: st.DrawFn) -> CameraCalibration:
    """Any lens of the product: both models, with and without the angle that it was measured to."""
    is_fisheye = draw(st.booleans())
    focal = draw(st.floats(0.25, 3.0)) * SIZE[0]
    camera = msgspec.structs.replace(
        RIG["left"].to_calibration(),
        fx=focal,
        fy=focal * draw(st.floats(0.9, 1.1)),
        cx=SIZE[0] / 2 + draw(numbers(20.0)),
        cy=SIZE[1] / 2 + draw(numbers(20.0)),
        distortion=draw(st.tuples(*map(numbers, (0.1, 0.05, 0.01, 0.01, 0.01)[: 4 if is_fisheye else 5]))),
        model="fisheye" if is_fisheye else msgspec.UNSET,
        seen_deg=draw(st.just(msgspec.UNSET) | st.floats(5.0, 40.0)),
    )
    assume(not camera_fault(camera))
    return camera


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return write_session(
        tmp_path_factory.mktemp("doors"), Scene([]), RIG, instants=1, calibrated=False, truth=False
    )


def doors(session: Session, root: Path, calibration: Calibration) -> Iterator[tuple[str, Calibration]]:
    """Write a calibration in each of our files, and yield what each reader finds."""
    dataset, sizes = Dataset(session), dict.fromkeys(RIG, SIZE)
    file = session.folder / CALIBRATION
    file.write_bytes(msgspec.json.encode(calibration))
    for path in (file, session.folder):
        yield f"--calibration {path.name}", fit_calibration(read_views([("", path)], [*RIG]), sizes)
        yield f"--from {path.name}", read_calibration(dataset, path)
    yield "--from session", session.calibration() or calibration
    keep_calibration(dataset, calibration)
    if (kept := find_calibration(camera_modes(dataset))) is not None:
        yield "--from kept", kept.with_origin
    record = ExportRecord(format="mp4", manifest=session.manifest, calibration=calibration)
    (root / RECORD).write_bytes(msgspec.json.encode(record))
    yield "an export", read_record(root).calibration or calibration


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lens=lenses())
def test_every_reader_finds_the_rays(lens: CameraCalibration, session: Session, tmp_path: Path) -> None:
    known = LensKnowledge(level="not", why="nobody saw it")
    right = RIG["right"].to_calibration()
    calibration = Calibration(cameras={"left": lens, "right": right}, source="ours", lenses=known)
    rays = rays_of(lens, GRID)
    for door, found in doors(session, tmp_path, calibration):
        camera = found.cameras["left"]
        np.testing.assert_allclose(rays_of(camera, GRID), rays, atol=1e-6, err_msg=door)
        assert (camera.seen_deg, found.known_lenses) == (lens.seen_deg, known), door
    view = View.from_calibration(lens, *SIZE)
    np.testing.assert_allclose(rays_of(view.to_calibration(), GRID), rays, atol=1e-6)
    matrices = open_session(session.folder).cameras["left"].calibration
    inner = ~np.isnan(rays).any(axis=1)
    np.testing.assert_allclose(matrices.lens.rays(GRID)[inner], rays[inner], atol=1e-6)
