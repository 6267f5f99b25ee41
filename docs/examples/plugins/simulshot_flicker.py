"""A check of the light: how much the brightness of two cameras differs."""

from typing import Annotated, Any

import msgspec
import numpy as np

from reconstruction.common import wording
from reconstruction.common.options import flag
from reconstruction.method.interface import Check
from reconstruction.method.score import Score
from reconstruction.method.study_result import StudyResult
from reconstruction.method.tally import Measurements, Tally
from reconstruction.method.words import MeasureText, StudyText

SECTION = """
<section aria-labelledby="{{ section.anchor }}">
<h2 id="{{ section.anchor }}">{{ section.title }}</h2>
<p>Instant {{ view.found.facts.brightest_instant }} is the brightest.</p>
{% from "tables.html" import table %}
{{ table(view.table) }}
</section>
"""


class Flicker(Check, frozen=True, kw_only=True):
    name = "flicker"
    study = f"{__name__}:FlickerScore"

    flicker_instants: Annotated[
        int, flag("--flicker-instants", metavar="N", help="Compare the light at this many instants.")
    ] = 8


class FlickerFacts(msgspec.Struct, frozen=True, kw_only=True):
    brightest_instant: int


class FlickerScore(Score):
    text = StudyText(
        name="flicker",
        subject="flicker of the light",
        term="Flicker",
        measures=(
            MeasureText("difference", "Brightness difference", "Of 255. Less is better.", wording.PLAIN),
        ),
        control=False,
        section=SECTION,
        title="How the light flickers",
    )
    min_cameras = 2
    Options = Flicker

    @classmethod
    def verdict(cls, result: Any, found: StudyResult[FlickerFacts]) -> str:
        return f"The light was measured at {found.instants} instants."

    def measure(self) -> StudyResult[FlickerFacts]:
        first, second = self.dataset.cameras[:2]
        assert self.context.offset is not None
        pairs = self.context.offset.pairs[: self.options.flicker_instants]
        tally, brightness = Tally(), {}
        for now, later in pairs:
            light = brightness[now] = self.dataset.grey(first, now).mean()
            shown = {"synced": now, "offset": later}
            apart = {side: abs(light - self.dataset.grey(second, k).mean()) for side, k in shown.items()}
            values = {side: Measurements(means={"difference": np.array([v])}) for side, v in apart.items()}
            tally.add(values, {"instant": now})
        return StudyResult(
            name=self.text.name,
            cameras=(first, second),
            instants=tally.instants,
            measures=tally.measures,
            per_instant=tally.per_instant,
            facts=FlickerFacts(brightest_instant=max(brightness, key=brightness.__getitem__)),
        )
