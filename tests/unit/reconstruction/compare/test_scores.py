"""A score that fails is not made, with its reason; any condition may be empty."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import BadInputError, IncompleteError, NotApplicableError
from capture_app.session.reading.reader import Session
from reconstruction.checks.triangulation.triangulation_study import SeenPoints, TriangulationStudy
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.interface import Method
from reconstruction.method.score import Context, Score
from reconstruction.method.tally import Measurements
from reconstruction.method.words import StudyText
from reconstruction.scene.conditions import SYNCED, Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene

RAISED: list[Exception] = []


class Numbers(Method, frozen=True, kw_only=True):
    """Yields each instant's number; under delays, what was raised."""

    name = "numbers"
    instants: tuple[int, ...] | None = None

    def run(self, scene: Scene, condition: Condition) -> Iterator[int]:
        if RAISED and condition.name != SYNCED:
            raise RAISED[0]
        yield from scene.dataset.chosen_instants(self.listed_instants)


class NumberScore(Score):
    text = StudyText(name="numbers", subject="numbers")
    Options = Numbers

    def measure_instant(self, result: int, one: Any, side: str) -> Measurements:
        assert result == one.instant
        return Measurements(means={"number": np.array([float(result + (side == "offset"))])})


@pytest.fixture
def score(boards: Session) -> NumberScore:
    RAISED.clear()
    return NumberScore(Context(scene=Scene(Dataset(boards)), max_instants=3))


def test_a_score_is_two_runs_of_its_method(score: NumberScore) -> None:
    made = score.run(CompareResult())
    assert made.cameras == score.dataset.cameras
    assert [row["offset_number"] - row["synced_number"] for row in made.per_instant] == [1] * made.instants
    assert made.instants == 3
    assert "--condition distinct@" in made.commands["offset"]
    assert "--condition" not in made.commands["synced"]


@pytest.mark.parametrize(
    "error",
    [ValueError("it cannot be"), BadInputError("it cannot be"), NotApplicableError("it cannot be")],
    ids=lambda error: type(error).__name__,
)
def test_what_fails_in_one_condition_is_not_made_and_says_why(score: NumberScore, error: Exception) -> None:
    RAISED.append(error)
    made = score.run(CompareResult())
    assert (made.skipped, made.failed, made.measures) == ("it cannot be", False, ())


def test_a_bug_fails_its_score_alone(score: NumberScore) -> None:
    RAISED.append(KeyError("a bug"))
    made = score.run(CompareResult())
    assert made.failed
    assert "KeyError" in made.skipped


def test_a_damaged_picture_ends_a_comparison(score: NumberScore) -> None:
    RAISED.append(IncompleteError("a picture is damaged"))
    with pytest.raises(IncompleteError):
        score.run(CompareResult())


def test_a_condition_without_any_point_is_drawn_and_measured(
    boards: Session, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenCV ends the process where it colours nothing."""
    context = Context(scene=Scene(Dataset(boards)), max_instants=1, folder=tmp_path)
    points = TriangulationStudy(context)
    points.cameras = ("left", "right")
    there = np.array([[0.0, 0.0, 3.0]])
    synced = SeenPoints(there, np.zeros(1), np.zeros(2, int), np.array([0, 1]), np.full((2, 2), 100))
    nothing = SeenPoints(there[:0], np.zeros(0), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2), int))
    monkeypatch.setattr(points, "_points", lambda shown: synced if len(set(shown.values())) == 1 else nothing)
    made = points.compare(Condition.parse("right=33"), tmp_path)
    assert (made.value("static_points"), made.value("static_points", "offset")) == (1, 0)
    assert (tmp_path / made.pictures[0].offset).is_file()
