"""`reconstruct batch`: its units, what it does with those that fail, and its summary."""

import csv
import fcntl
import json
import shutil
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, DiskFullError, ExitCode, NotAvailableError
from capture_app.session.reading.reader import Session
from reconstruction.methods.batch.batch_plan import BatchPlan
from reconstruction.methods.batch.batch_run import batch, exit_code
from reconstruction.methods.batch.summary import UnitRow, depth_sheets
from reconstruction.methods.batch.units import Shard
from reconstruction.methods.batch.workers import NO_DASHBOARD, Workers
from reconstruction.scene.conditions import Condition
from tests.unit.reconstruction.conftest import VIEWS, Scene, write_session
from tests.unit.reconstruction.methods.batch.fake_units import FAKE_TASK


@pytest.fixture(scope="module")
def here() -> Iterator[Workers]:
    """Workers of a Dask scheduler whose worker is a thread of this process."""
    # Half a second, only where it is used: each of pytest's workers imports all tests.
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=NO_DASHBOARD
    ) as cluster:
        yield Workers(cluster.scheduler_address)


@pytest.fixture
def run(
    boards: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str], here: Workers
) -> Callable[..., Any]:
    def run(*, workers: Any = None, task: str = FAKE_TASK, sessions: Any = None, **options: Any) -> Any:
        result = batch(
            sessions or [boards.folder], tmp_path / "out", BatchPlan(**options), workers or here, task
        )
        lines = capsys.readouterr().err.splitlines()
        return SimpleNamespace(result=result, lines=lines, out=tmp_path / "out")

    return run


def test_the_summary_says_the_same_in_three_formats(run: Callable[..., Any]) -> None:
    done = run(conditions=(Condition("synced"), Condition.parse("66")), instants=(0, 4, 99))
    rows = list(csv.DictReader((done.out / "summary.csv").read_text().splitlines()))
    told = json.loads((done.out / "summary.json").read_text())
    page = (done.out / "summary.html").read_text()
    assert [(row["instant"], row["condition"]) for row in rows] == [
        (str(unit["instant"]), unit["condition"]) for unit in told["units"]
    ]
    assert [group["failed"] for group in told["groups"]] == [1, 2]
    assert [group["instants"] for group in told["groups"]] == [2, 1]
    assert "no instant 99" in rows[-1]["error"]
    assert page.count("<tr>") == 2 + 2 + sum(not row["error"] for row in rows)
    assert page.count("<dt>") == sum(bool(row["error"]) for row in rows)
    assert "3 units computed, 3 failed" in page
    assert rows[0]["coverage"] == "0.5"


def test_a_sheet_shows_instants_evenly_and_lives_without_a_picture(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "depth.png"), np.full((90, 320, 3), 80, np.uint8))
    (tmp_path / "spoilt.png").write_bytes(b"not a picture")
    rows = [
        UnitRow(
            session="take", instant=k, condition="synced", picture="spoilt.png" if k == 0 else "depth.png"
        )
        for k in range(30)
    ]
    rows += [UnitRow(session="take", instant=5, condition="66", error="too dark")]
    (sheet,) = depth_sheets(tmp_path, rows)
    assert sheet["instants"] == [0, 3, 5, 8, 11, 13, 16, 18, 21, 24, 26, 29]
    ((condition, cells),) = sheet["rows"]
    assert condition == "synced"
    assert cells[0] is None
    assert all(cell["width"] == 160 and cell["path"] == "depth.png" for cell in cells[1:])


def test_no_name_becomes_markup_in_the_summary(run: Callable[..., Any], scene: Scene, tmp_path: Path) -> None:
    session = write_session(tmp_path / "<script>", scene, {name: VIEWS[name] for name in ("left", "right")})
    session.folder.rename(tmp_path / "<script>" / "<script>alert(1)<!--")
    done = run(sessions=[tmp_path / "<script>" / "<script>alert(1)<!--"], instants=(0, 99))
    page = (done.out / "summary.html").read_text()
    assert page.count("<script>") == 1
    assert page.count("&lt;script&gt;alert(1)&lt;!--") == 3
    assert 'href="units/%3Cscript%3Ealert%281%29%3C%21--/0000-synced-' in page


def test_what_is_not_applicable_synchronized_is_not_judged_otherwise(run: Callable[..., Any]) -> None:
    conditions = (Condition.parse("66"), Condition.parse("synced"))
    task = "tests.unit.reconstruction.methods.batch.fake_units:refuse_synchronized"
    done = run(task=task, conditions=conditions, instants=(0, 2)).result
    judged = {(row.instant, row.condition): (row.coverage, bool(row.not_applicable)) for row in done.units}
    assert judged == {
        (0, "synced"): (None, True),
        (0, "66ms"): (None, True),
        (2, "synced"): (0.5, False),
        (2, "66ms"): (0.5, False),
    }
    assert (done.computed, done.failed, done.not_applicable) == (2, 0, 2)
    assert {(of.condition, of.instants) for of in done.groups} == {("66ms", 1), ("synced", 1)}


def test_all_failed_alike_is_that_exit_code(run: Callable[..., Any], tmp_path: Path) -> None:
    done = run(sessions=[tmp_path / "a", tmp_path / "b"])
    assert exit_code(done.result) is ExitCode.BAD_INPUT


def test_one_camera_only_is_one_line(run: Callable[..., Any], scene: Scene, tmp_path: Path) -> None:
    lonely = write_session(tmp_path, scene, {"left": VIEWS["left"]}, instants=2)
    done = run(sessions=[lonely.folder])
    assert [row.not_applicable[:31] for row in done.result.units] == ["the session has one camera only"]


def test_nothing_is_begun_on_a_full_disk(run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1 << 10))
    done = run(instants=(0,))
    assert done.result.computed == 0
    assert "is full" in done.result.units[0].error
    assert done.result.units[0].exit_code == DiskFullError.exit_code


def test_where_there_is_no_cluster(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NotAvailableError, match=r"sbatch.*--cluster local"):
        Workers("slurm")
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(NotAvailableError, match=r"dask.jobqueue"):
        Workers("slurm")
    with pytest.raises(BadInputError, match=r"'slum' is not a cluster.*slurm.*tcp://"):
        Workers("slum")
    with pytest.raises(BadInputError, match="'gpu' is not a setting"):
        Workers("slurm", settings=["gpu"])


def test_a_queue_writes_nothing_beside_the_users_settings(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Before, the first batch with --cluster left ~/.config/dask/jobqueue.yaml."""
    for name in [one for one in sys.modules if one.startswith("dask_jobqueue")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr("dask.config.PATH", str(tmp_path / "dask"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NotAvailableError, match="sbatch"):
        Workers("slurm")
    assert not (tmp_path / "dask").exists()


def test_no_scheduler_at_an_address_is_one_line(run: Callable[..., Any]) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        with pytest.raises(NotAvailableError, match=f"no Dask scheduler answers at {address}"):
            run(workers=Workers(address), instants=(0,))


@contextmanager
def locked(path: Path) -> Iterator[None]:
    path.parent.mkdir(parents=True)
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def test_two_batches_do_not_share_a_folder(run: Callable[..., Any], tmp_path: Path) -> None:
    with (
        locked(tmp_path / "out" / "work" / "batch.lock"),
        pytest.raises(BadInputError, match="another run"),
    ):
        run()


def test_a_shard_runs_once_and_beside_another(boards: Session, here: Workers, tmp_path: Path) -> None:
    def run(part: Shard) -> int:
        options = BatchPlan(instants=(0, 1))
        return batch([boards.folder], tmp_path / "out", options, here, FAKE_TASK, part).computed

    with locked(tmp_path / "out" / "work" / "shard-1-of-2.lock"):
        with pytest.raises(BadInputError, match="another run"):
            run(Shard(1, 2))
        assert run(Shard(2, 2)) == 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/3"])
def test_what_is_not_a_shard_is_one_line(text: str) -> None:
    with pytest.raises(BadInputError, match="not a shard"):
        Shard.parse(text)


def test_foreign_files_are_left_alone(run: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("mine")
    with pytest.raises(BadInputError, match=r"thesis\.txt"):
        run()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.txt"]
