"""`reconstruct multiview --instants`: what is there is kept, and what would not belong is refused."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.methods.multiview.result import SequenceInstant
from reconstruction.methods.multiview.sequence import (
    CLOUDS,
    INSTANTS,
    PLAN,
    RESULT,
    SequenceFolder,
    SequencePlan,
    cloud_file,
)


def plan_of(**changed: Any) -> SequencePlan:
    plan = SequencePlan(
        session="s",
        pictures="f",
        condition="synced",
        time_shifts_ms={},
        matcher="sweep",
        mesh=False,
        depth=False,
    )
    return msgspec.structs.replace(plan, **changed)


def test_a_folder_keeps_its_clouds_for_the_same_plan_alone(tmp_path: Path) -> None:
    out, one = tmp_path / "out", SequenceInstant(instant=3, leader_ns=5, cloud=cloud_file(3))
    with SequenceFolder.opened(out, plan_of()) as folder:
        assert folder.done(3) is None
        folder.finish(one)
        assert folder.done(3) is None
        (out / cloud_file(3)).write_bytes(b"cloud")
        (folder.empty_work() / "left").write_bytes(b"behind")
        assert folder.done(3) == one
        assert folder.done(4) is None
    assert not (out / ".work").exists()
    (out / CLOUDS / "000009.ply.part").write_bytes(b"half")
    with SequenceFolder.opened(out, plan_of()) as folder:
        assert folder.done(3) == one
        assert folder.calibration() is None
        assert folder.files == (CLOUDS, INSTANTS, PLAN, RESULT)
        assert [path.name for path in (out / CLOUDS).iterdir()] == ["000003.ply"]
    for changed, said in (
        ({"depth": True}, "made without --depth"),
        ({"quick": True}, "made without --quick"),
        ({"condition": "33ms"}, "of condition 'synced', not '33ms'"),
    ):
        with pytest.raises(BadInputError, match=said), SequenceFolder.opened(out, plan_of(**changed)):
            pass
    assert (out / cloud_file(3)).is_file()
    # Without its cloud an instant is to do, and the folder free for another plan; it goes if nothing is made.
    (out / cloud_file(3)).unlink()
    with SequenceFolder.opened(out, plan_of(depth=True)) as folder:
        assert folder.done(3) is None
    assert not out.exists()


def test_a_broken_plan_is_refused_and_the_clouds_stay(tmp_path: Path) -> None:
    with SequenceFolder.opened(tmp_path / "out", plan_of()):
        (tmp_path / "out" / cloud_file(3)).write_bytes(b"cloud")
    (tmp_path / "out" / PLAN).write_bytes(b"{")
    with (
        pytest.raises(BadInputError, match="is broken"),
        SequenceFolder.opened(tmp_path / "out", plan_of()),
    ):
        pass
    assert (tmp_path / "out" / cloud_file(3)).is_file()
