"""Check of a score's words before anybody reads them, on results with and without each field.

A test of a package with a method calls `check_words` with its score. Ours are checked so too.
"""

from collections.abc import Iterator
from itertools import product
from typing import Any

from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from reconstruction.common.native_libraries import unexpected_error
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.score import Score
from reconstruction.method.study_result import Interval, Measure, StudyResult
from reconstruction.method.timing import Timing

CAMERAS = ("cam1", "cam2", "cam3")
VALUES = ((0.9, 0.9), (0.9, 0.2), (0.9, 0.6), (0.2, 0.9), (1.0, 40.0))
"""Values of a measure in both conditions, from which sentences choose."""


def check_words(score: type[Score], facts: Any = None) -> None:
    """Render the sentences and table texts of a score, of results with and without each measure.

    `facts`: an example of the results that only this score has, if its words read them.

    Raises:
        BadInputError: a template or a text names what does not exist; it says which.
    """
    text = score.text
    texts = (text.caption, text.engine, text.details, *(measure.text for measure in text.measures))
    try:
        for study, result in _results(score, facts):
            placeholders = score.placeholders(study)
            for sentence in texts:
                sentence.format(**placeholders)
            for say in (score.verdict, score.as_recorded, score.control_sentence):
                say(result, study)
    except Exception as error:
        raise BadInputError(
            f"the words of {score.__module__} fail: {unexpected_error(error).what}",
            hint="correct the template or the key that it names",
        ) from error


def _results(score: type[Score], facts: Any) -> Iterator[tuple[StudyResult[Any], CompareResult]]:
    """Yield results of the score, and of the comparison that they are part of."""
    cameras = CAMERAS[:2] if score.of_pair else CAMERAS
    prefixes = ("mover_", "static_") if score.text.control else ("",)
    names = [prefix + measure.key for measure in score.text.measures for prefix in prefixes]
    timings = [None, *_timings()]
    for (synced, offset), missing in product(VALUES, ("", *names)):
        known = Interval(value=synced), Interval(value=offset)
        measures = tuple(Measure(name=n, synced=known[0], offset=known[1]) for n in names if n != missing)
        study = StudyResult(name=score.text.name, cameras=cameras, instants=9, measures=measures, facts=facts)
        for timing in timings:
            yield study, CompareResult(studies=(study,), timing=timing, actual_offset_ms=67.0)


def _timings() -> Iterator[Timing]:
    """Yield the judgements of a pair's timing that words distinguish."""
    same = Timing(reference=CAMERAS[0], other=CAMERAS[1], synchronized=True, late_ms=0.1, uncertainty_ms=0.4)
    yield same
    yield replace(same, synchronized=False, offset=True, late_ms=33.0)
    yield replace(same, synchronized=False, late_ms=None, uncertainty_ms=None, reason="nothing moves")
    yield replace(same, moving_cameras={CAMERAS[0]: 3.0})
