"""Conditions as data: lists of offsets, drawn ones, another session, each beside the synchronized one."""

import json
from pathlib import Path

import pytest

from capture_app.session.reader import Session
from reconstruction.cli import main
from reconstruction.conditions import DRAWN_MS, Condition, drawn, pair_offset
from reconstruction.dataset import Dataset


@pytest.mark.parametrize("cameras", [2, 5, 8])
def test_drawn_offsets_are_distinct_as_far_as_they_go(cameras: int) -> None:
    names = [f"cam{i:02d}" for i in range(cameras)]
    offsets = [late for _, late in drawn(names).offsets_ms]
    assert len(offsets) == cameras
    assert len(set(offsets)) == min(cameras, len(DRAWN_MS))
    assert drawn(names) == drawn(names)


def test_a_pair_sees_the_difference_of_its_offsets_in_either_direction(boards: Session) -> None:
    dataset = Dataset(boards)
    condition = Condition("list", (("left", 66.0), ("right", 33.0)))
    early = pair_offset(dataset, condition, "left", "right")
    late = pair_offset(dataset, condition, "right", "left")
    assert early.frames == -1
    assert early.pairs == ((1, 0), (2, 1), (3, 2), (4, 3))
    assert late.frames == 1
    assert late.pairs == ((0, 1), (1, 2), (2, 3), (3, 4))
    with pytest.raises(ValueError, match="equally late"):
        pair_offset(dataset, Condition("same", (("left", 66.0), ("right", 66.0))), "left", "right")


def test_compare_judges_further_conditions_beside_the_synchronized_one(
    boards: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    main(
        [
            *("compare", str(boards.folder), "--out", str(out), "--json"),
            *("--stereo", "left,right", "--stitch", "left,aside"),
            *("--offsets-ms", "left=33,right=0", "--offsets-ms", "left=33,right=33"),
            *("--against", str(boards.folder)),
        ]
    )
    result = json.loads(capsys.readouterr().out)
    early, same, itself = result["conditions"]
    assert early["stereo_offset_ms"] == pytest.approx(-33.3, abs=0.1)
    assert early["stereo"]["synced"]["mover_within_2pct"] > 0.9
    assert early["stereo"]["offset"]["mover_within_2pct"] < 0.05
    change = early["stereo"]["differences"]["mover_within_2pct"]
    assert change["low"] <= change["value"] <= change["high"] < -0.8
    assert abs(early["stereo"]["differences"]["static_coverage"]["value"]) < 0.02
    assert early["stitch"]["offset"]["overlap_flow_p95_px"] > early["stitch"]["synced"]["overlap_flow_p95_px"]
    assert same["stereo"] is None
    assert "equally late" in same["skipped"][0]
    assert itself["session"] == str(boards.folder)
    assert itself["stereo"]["offset"]["mover_within_2pct"] > 0.9
    assert len(result["dose"]["points"]) == 3
    assert len(result["burst"]["thumbnails"]) == 3
    page = (out / "report.html").read_text("utf-8")
    for words in ("All conditions", "The burst", "How much lateness this motion bears", "Every instant"):
        assert words in page


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [("left=66,nobody=0", 3, "no camera 'nobody'"), ("left", 2, "cam00=0"), ("left=soon", 2, "cam00=0")],
)
def test_wrong_lists_are_one_line(
    boards: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, code: int, words: str
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["compare", str(boards.folder), "--offsets-ms", text, "--out", str(tmp_path / "out")])
    assert end.value.code == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert words in errors[0]
    assert not (tmp_path / "out").exists()
