"""Values that several commands take on the command line."""

import math
from typing import Any

import click


class Finite(click.FloatRange):
    """A range that holds numbers only."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Refuse what compares with nothing."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number of ms", param, ctx)
        return float(number)


class Pair(click.ParamType[tuple[str, str]]):
    """Two cameras' names with a comma between."""

    name = "A,B"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        """Split the text."""
        names = [part.strip() for part in str(value).split(",")]
        if len(names) != 2 or not all(names):
            self.fail(f"{value!r} is not two cameras with a comma between, as in cam00,cam01", param, ctx)
        return names[0], names[1]


class Offsets(click.ParamType[tuple[tuple[str, float], ...]]):
    """Cameras and how late they are: CAMERA=MS with commas between."""

    name = "CAM=MS,..."

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[tuple[str, float], ...]:
        """Split the text."""
        found: dict[str, float] = {}
        for part in str(value).split(","):
            camera, _, text = part.partition("=")
            try:
                late = float(text)
            except ValueError:
                late = math.nan
            if not camera.strip() or not math.isfinite(late) or camera.strip() in found:
                self.fail(f"{value!r} is not cameras with ms, as in cam00=0,cam01=66", param, ctx)
            found[camera.strip()] = late
        return tuple(found.items())
