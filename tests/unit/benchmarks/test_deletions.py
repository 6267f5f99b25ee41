"""Deletions change the one part that they name, and change it back."""

from pathlib import Path

import pytest

from benchmarks import delete_parts
from benchmarks.delete_parts import Deletion, find_deletions

TEXT = '''
def judge(value: int, limit: int) -> str:
    """Judge."""
    said: str
    said = "low"
    if value > 0 and value < limit:
        said += "er"
    return said
'''
KINDS = (
    "statement \"said = 'low'\"", "statement \"said += 'er'\"", "statement 'return said'",
    "condition 'value > 0'", "condition 'value < limit'", "limit of 'value > 0'", "limit of 'value < limit'",
)  # fmt: skip


@pytest.fixture
def deletions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Deletion]:
    (tmp_path / "judge.py").write_text(TEXT)
    monkeypatch.setattr(delete_parts, "ROOT", tmp_path)
    return {of.what: of for of in find_deletions(Path("judge.py"), fine=True)}


def test_fine_deletions_are_of_statements_and_conditions(deletions: dict[str, Deletion]) -> None:
    assert sorted(deletions) == sorted(KINDS)


@pytest.mark.parametrize(
    ("what", "values"),
    [
        (KINDS[1], ("low", "low", "low")),
        (KINDS[2], (None, None, None)),
        (KINDS[3], ("lower", "lower", "low")),
        (KINDS[4], ("low", "lower", "lower")),
        (KINDS[5], ("lower", "lower", "low")),
        (KINDS[6], ("low", "lower", "lower")),
    ],
)
def test_a_fine_deletion_leaves_the_rest(
    deletions: dict[str, Deletion], what: str, values: tuple[str | None, ...]
) -> None:
    def judge(value: int, limit: int) -> str:
        raise NotImplementedError

    judge.__code__ = deletions[what].code()
    assert tuple(judge(value, 3) for value in (0, 1, 3)) == values
    judge.__code__ = deletions[KINDS[0]].code()
    with pytest.raises(UnboundLocalError):
        judge(0, 3)
