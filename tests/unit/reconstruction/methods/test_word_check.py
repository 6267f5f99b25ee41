"""Words of methods are checked before anybody reads them, and what fails costs its own sentence only."""

from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.method.score import Score, say_all, study_reports
from reconstruction.method.word_check import check_words
from reconstruction.method.words import MeasureText, StudyText, read_words
from reconstruction.methods.splat.splat_study import SplatFacts
from reconstruction.report.comparison_report import write_report
from reconstruction.report.findings import verdict
from tests.unit.reconstruction.report.results import whole_result

SPLAT = SplatFacts(instant=3, reference="cam1", made_from=("cam2",), iterations=9, gaussians={}, picture="")


@pytest.mark.parametrize("name", study_reports())
def test_the_words_of_every_installed_score_can_be_said(name: str, tmp_path: Path) -> None:
    facts = {"splat": SPLAT} | {found.name: found.facts for found in whole_result(tmp_path).studies}
    check_words(study_reports()[name], facts.get(name))


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"verdict": "{{ found.valeu('mover_size') }}"}, "valeu"),
        ({"verdict": "{% if found.value('mover_size') is none %}{{ reslut }}{% endif %}"}, "reslut"),
        ({"as_recorded": "{% if not together %}{{ result.timming }}{% endif %}"}, "timming"),
        ({"control_sentence": "{% if result.cameras_moved %}{{ moved }}{% endif %}"}, "moved"),
        ({"engine": "Found by {engin}."}, "engin"),
        ({"measures": (MeasureText("size", "Size", "Of {camera}."),)}, "camera"),
    ],
)
def test_a_wrong_name_is_found_wherever_it_stands(wrong: dict[str, Any], what: str) -> None:
    class Sized(Score):
        text: ClassVar[StudyText] = msgspec.structs.replace(
            StudyText(name="sized", subject="sizes", measures=(MeasureText("size", "Size", ""),)), **wrong
        )

    with pytest.raises(BadInputError, match=what):
        check_words(Sized)


@pytest.mark.parametrize(
    "line", ['captoin = "x"', '[[measures]]\nkey = "a"\nname = "b"\ntext = "c"\nmising = 1']
)
def test_a_misspelt_key_is_refused_with_its_file(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "misspelt_words"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "words.toml").write_text(f'name = "x"\nsubject = "y"\n{line}\n')
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BadInputError, match=r"words\.toml: .*(captoin|mising)"):
        read_words("misspelt_words")


def test_a_comparison_outlives_the_words_of_a_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stereo = study_reports()["stereo"]
    broken = {"verdict": "{{ found.valeu }}", "section": "<p>{{ view.nothing }}</p>", "title": "Depth"}
    monkeypatch.setattr(stereo, "text", msgspec.structs.replace(stereo.text, **broken))
    result = whole_result(tmp_path)
    assert "depth (its words failed: unexpected UndefinedError" in say_all(result, verdict)
    page = write_report(result, tmp_path).read_text()
    assert "its words failed: unexpected UndefinedError" in page
    assert "Panorama" in page, "the other methods are there"
