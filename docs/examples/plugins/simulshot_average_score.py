"""Score of the average: pictures of one instant fit together better than others."""

from typing import Any

import numpy as np
from simulshot_average import Average

from reconstruction.common import wording
from reconstruction.method.score import Score
from reconstruction.method.tally import Measurements
from reconstruction.method.words import MeasureText, StudyText

CONTRAST = MeasureText("contrast", "Contrast", "Scatter of the grey levels. More is better.", wording.PLAIN)


class AverageScore(Score):
    text = StudyText(name="average", subject="the average", measures=(CONTRAST,), control=False)
    Options = Average

    def measure_instant(self, result: Any, one: Any, side: str) -> Measurements:
        return Measurements(means={"contrast": np.array([result.std()])})
