"""`reconstruct batch`: its units, what it does with those that fail, and its summary."""

import csv
import fcntl
import json
import shutil
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, DiskFullError, ExitCode, NotAvailableError
from capture_app.session.reading.reader import Session
from reconstruction.batch import workers
from reconstruction.batch.batch_plan import DEPTH_TASK, BatchPlan
from reconstruction.batch.batch_run import batch, exit_code, summarize
from reconstruction.batch.summary import UnitRow, depth_sheets
from reconstruction.batch.units import Shard, run_unit
from reconstruction.batch.workers import NO_DASHBOARD, Workers
from reconstruction.depth.matchers import Matcher
from reconstruction.scene.conditions import Condition
from tests.reconstruction.batch.fake_units import FAKE_TASK
from tests.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, make_view, write_session

FAILING = "tests.reconstruction.batch.fake_units:compute_or_fail"


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


@pytest.mark.slow
def test_real_units_in_processes_and_nothing_twice(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    asked = (boards.folder, "--instants", 2, "--condition", "synced", "--condition", 66, "--out", out)
    printed = reconstruct("batch", *asked, "--json")
    result = printed.result
    assert (result["computed"], result["reused"], result["failed"]) == (2, 0, 0)
    assert [line[:5] for line in printed.err.splitlines()] == ["[1/2]", "[2/2]"]
    assert "left" in printed.err.splitlines()[0]
    synced, offset = result["groups"]
    assert synced["mover_within_2pct"] > 0.5 > 0.1 > offset["mover_within_2pct"]
    assert abs(synced["static_within_2pct"] - offset["static_within_2pct"]) < 0.5
    for row in result["units"]:
        assert (out / row["folder"] / "fused.ply").stat().st_size > 1000
    page = (out / "summary.html").read_text()
    assert page.count("data:image/webp") == 2
    for row in result["units"]:
        assert f'href="{row["picture"]}"' in page
        assert (out / row["picture"]).stat().st_size > 1000
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    printed = reconstruct("batch", *asked)
    assert printed.out.splitlines()[0] == "0 computed, 2 reused, 0 failed"
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_what_no_depth_can_be_made_of_is_not_applicable_and_no_failure(
    run: Callable[..., Any], boards: Session, scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    apart = {"left": VIEWS["left"], "away": make_view((0.1, 0, 0), yaw=58)}
    strangers = write_session(tmp_path / "strangers", scene, apart, instants=1, truth=False)
    lonely = write_session(tmp_path / "lonely", scene, {"left": VIEWS["left"]}, instants=1, truth=False)
    asked = ("batch", strangers.folder, lonely.folder, "--out", tmp_path / "none")
    first, again = reconstruct(*asked), reconstruct(*asked)
    assert "boards, instant 0, synced: not applicable: " in first.err
    assert "not applicable: the session has one camera only (left)" in first.err
    # A result as any other: it is not computed again.
    assert "reusing 1 of 1 results" in again.err
    for printed in (first, again):
        assert printed.code == ExitCode.BAD_INPUT
        assert "nothing could be computed" in printed.err
        assert printed.out.splitlines()[0] == "0 computed, 0 reused, 0 failed, 2 not applicable"
    beside = run(sessions=[boards.folder, lonely.folder], instants=(0,))
    assert (beside.result.computed, beside.result.failed, beside.result.not_applicable) == (1, 0, 1)
    assert exit_code(beside.result) is ExitCode.OK
    assert "1 unit computed, 1 not applicable" in (beside.out / "summary.html").read_text()


def test_units_that_fail_leave_the_others_alone(
    run: Callable[..., Any], boards: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions = [boards.folder, boards.folder / "nowhere"]
    with monkeypatch.context() as patch:
        patch.setattr(workers, "CONNECT_S", 1e-9)  # a scheduler of its own may take long to start
        done = run(workers=Workers(jobs=1), task=FAILING, sessions=sessions)
    problems = {row.instant: row.error for row in done.result.units}
    assert problems[0] == "ValueError: unheard of in two lines"
    assert "its process died twice" in problems[1]
    assert " is full (make room" in problems[2]
    assert "memory" in problems[3]
    assert problems[4] == ""
    assert "no session at" in problems[None]
    assert (done.result.computed, done.result.failed) == (1, 5)
    assert exit_code(done.result) is ExitCode.INCOMPLETE
    assert sum("failed: " in line for line in done.lines) == 5
    assert not list(done.out.rglob("*.part"))
    # Only what failed is tried again.
    again = run(task=FAKE_TASK)
    assert (again.result.computed, again.result.reused, again.result.failed) == (4, 1, 0)
    assert exit_code(again.result) is ExitCode.OK


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
    task = "tests.reconstruction.batch.fake_units:refuse_synchronized"
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


@pytest.mark.slow
def test_a_key_is_of_all_that_the_result_depends_on(boards: Session, tmp_path: Path) -> None:
    def keys(
        folder: Path = boards.folder,
        condition: str = "synced",
        matcher: Matcher = Matcher.SWEEP,
        program: str = "1",
        shifts_ms: Mapping[str, float] | None = None,
    ) -> Any:
        options = BatchPlan(
            conditions=(Condition.parse(condition),),
            matcher=matcher,
            program=program,
            time_shifts_ms=shifts_ms or {},
        )
        units, _ = options.units(folder)
        return [unit.key for unit in units]

    first = keys()
    assert len(set(first)) == 5
    assert keys() == first
    copied = shutil.copytree(boards.folder, tmp_path / "elsewhere" / boards.folder.name)
    assert keys(copied) == first
    assert keys(matcher=Matcher.AUTO) == first
    assert not set(keys(matcher=Matcher.PATCHMATCH)) & set(first)
    assert not set(keys(shifts_ms={"right": PERIOD_NS / 1e6})) & set(first)
    assert not set(keys(condition="0,0,0")) & set(first)
    truth = boards.ground_truth("left", 1)
    assert truth is not None
    (copied / truth.relative_to(boards.folder)).write_bytes(b"other")
    assert [a == b for a, b in zip(keys(copied), first, strict=True)] == [True, False, True, True, True]
    (copied / "calibration.json").unlink()
    assert not set(keys(copied)) & set(first)
    assert not set(keys(program="another version")) & set(first)


@pytest.mark.slow
def test_a_damaged_image_is_no_input_of_its_instant_and_spoils_no_other(
    boards: Session, tmp_path: Path
) -> None:
    """Before, what moves at the instants beside it could not be seen, so that these failed, too."""
    copied = shutil.copytree(boards.folder, tmp_path / boards.folder.name)
    image = copied / boards.image_file(boards.images_by_instant()[0]["left"]).relative_to(boards.folder)
    data = bytearray(image.read_bytes())
    data[-20] ^= 1
    image.write_bytes(data)
    units, _ = BatchPlan(instants=(0, 1)).units(copied)
    outcomes = [run_unit(DEPTH_TASK, unit, tmp_path / "out") for unit in units]
    assert [outcome.exit_code for outcome in outcomes] == [ExitCode.INCOMPLETE, ExitCode.OK]
    assert "is damaged" in outcomes[0].error
    result = json.loads((tmp_path / "out" / units[1].folder / "unit.json").read_bytes())
    assert result["changed_pictures"] == [str(image)]


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


def test_a_summary_names_what_is_not_computed_yet(boards: Session, here: Workers, tmp_path: Path) -> None:
    options = BatchPlan(instants=(0, 1))
    batch([boards.folder], tmp_path / "out", options, here, FAKE_TASK, Shard(1, 2))
    found = summarize([boards.folder], tmp_path / "out", options)
    assert [row.error for row in found.units] == ["", "it is not computed yet"]
    assert exit_code(found) is ExitCode.INCOMPLETE
    assert (tmp_path / "out" / "summary.html").is_file()


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


@pytest.mark.long
def test_shards_make_the_same_splats_as_one_command(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    asked = ("batch", boards.folder, "--instants", "2-3", "--splats", "--jobs", 1)
    reconstruct(*asked, "--out", tmp_path / "whole")
    for extra in (("--shard", "1/2"), ("--shard", "2/2"), ("--summary",)):
        reconstruct(*asked, *extra, "--out", tmp_path / "parts")
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
