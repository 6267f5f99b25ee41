"""The bundled sample sessions: whole, true and small."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.samples.__main__ import run as render_command
from benchmarks.simulated import panel_photographs
from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.panel import panel_photograph
from capture_app.session.format.manifest import RECIPE, row_exposures
from capture_app.session.reading.reader import Session
from tests.project import SAMPLES

SHAPES = {"jumper": (5, 5), "naive": (5, 5), "pinwheel": (5, 5), "crossing": (3, 5), "led_panel": (2, 5)}
NAMES = sorted(path.parent.name for path in SAMPLES.glob(f"*/{RECIPE}"))
SYNCHRONIZED = [name for name in NAMES if name != "naive"]


def truth_of(session: Session) -> dict[tuple[str, int], int]:
    """By camera and instant, the true start of an image's first row, in ns."""
    true_times = session.true_times()
    assert true_times is not None
    return {(true.camera, true.instant): true.true_ns for true in true_times.images}


def test_all_samples_are_there_and_small() -> None:
    assert set(SHAPES) == set(NAMES)
    assert sum(path.stat().st_size for path in SAMPLES.rglob("*")) < 30_000_000


def test_all_samples_verify(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sessions", "verify", *(str(SAMPLES / name) for name in NAMES)]) == ExitCode.OK
    assert capsys.readouterr().out.count("are intact") == len(NAMES)


@pytest.mark.parametrize("name", SHAPES)
def test_every_camera_has_an_image_of_every_instant(name: str) -> None:
    manifest = Session.open(SAMPLES / name).manifest
    cameras, instants = SHAPES[name]
    assert len(manifest.cameras) == cameras
    assert len(manifest.images) == cameras * instants
    assert not manifest.missing


@pytest.mark.parametrize("name", SYNCHRONIZED)
def test_the_truth_lies_within_what_the_record_allows(name: str) -> None:
    session = Session.open(SAMPLES / name)
    truth = truth_of(session)
    assert session.manifest.sync is not None
    for record in session.manifest.images:
        assert record.hard_bound_ns is not None
        assert record.exposure_start_ns is not None
        # A stamp is noisy by some us; the leader's clock is the true one.
        error_ns = abs(record.exposure_start_ns - truth[record.camera, record.instant])
        assert error_ns < record.hard_bound_ns + 20_000
        rows = row_exposures(session.camera(record.camera), record)
        assert rows is not None
        assert rows.middle_ns(rows.rows - 1) - rows.middle_ns(0) == (rows.rows - 1) * rows.row_time_ns
    spreads = [
        np.ptp([truth[camera.name, instant] for camera in session.manifest.cameras])
        for instant in range(len(session.manifest.burst.instants_ns))
    ]
    assert max(spreads) < 250_000


def test_naive_is_as_far_apart_as_the_paper_found(capsys: pytest.CaptureFixture[str]) -> None:
    truth = truth_of(Session.open(SAMPLES / "naive"))
    times = [true_ns for (_, instant), true_ns in truth.items() if instant == 0]
    assert 60e6 < np.ptp(times) < 677e6
    assert run(["sessions", "show", str(SAMPLES / "naive")]) == ExitCode.OK
    out = capsys.readouterr().out
    assert "not known" in out
    assert "by the ground truth" in out


def test_the_time_can_be_read_off_the_panel_of_leds() -> None:
    session = Session.open(SAMPLES / "led_panel")
    truth = truth_of(session)
    for record in session.manifest.images[:4]:
        picture = cv2.imread(str(session.image_file(record)))
        row_time_ns = session.camera(record.camera).facts.row_time_ns
        assert picture is not None
        assert record.exposure_ns is not None
        assert row_time_ns is not None
        picture = np.asarray(picture, np.uint8)
        read_ns = panel_photographs.read_time(
            picture, exposure_ns=record.exposure_ns, row_time_ns=row_time_ns
        )
        true_ns = truth[record.camera, record.instant] % panel_photograph.CYCLE_NS
        assert abs(panel_photographs.difference_ns(read_ns, true_ns)) < 5_000


def test_depth_is_in_steps_and_reaches_across_the_room() -> None:
    path = Session.open(SAMPLES / "jumper").ground_truth("cam00", 0)
    assert path is not None
    with np.load(path) as truth:
        depth_m = truth["depth_m"]
        assert depth_m.dtype == np.float32
        assert np.array_equal(depth_m * 2048, np.rint(depth_m * 2048))
        assert 1 < depth_m.min() < depth_m.max() < 6
        assert 0.02 < truth["movers"].mean() < 0.3


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scene": "moon"}, "moon"),
        ({"cameras": [{"name": "cam00", "profile": "brick"}], "take": None}, "brick"),
        ({"cameras": []}, "cameras"),
        ({"cameras": [{"name": "cam00"}, {"name": "cam00"}]}, "twice"),
        ({"cameras": [{"name": "../up"}]}, "name"),
        ({"schema_version": 99}, "schema version 99"),
        ({"seed": "x"}, "seed"),
        ({"cameras": [{"name": "other"}]}, "other cameras"),
    ],
)
def test_a_bad_recipe_is_refused_with_its_reason(
    change: dict[str, object], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads((SAMPLES / "pinwheel" / RECIPE).read_text())
    recipe = tmp_path / RECIPE
    recipe.write_text(json.dumps({**content, **change}))
    assert render_command([str(recipe), "--out", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert reason in error
    assert len(error.splitlines()) == 1
    assert not list((tmp_path / "out").glob("*"))
