"""Values that several commands take on the command line."""

import math
from typing import TYPE_CHECKING, Any

import click

from capture_app.errors import BadInputError

if TYPE_CHECKING:
    from reconstruction.session.conditions import Condition


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


class Offsets(click.ParamType["Condition"]):
    """How late each camera is: CAMERA=MS with commas between, or MS for each, or MS for every second one."""

    name = "CAM=MS,...|MS,..."

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> "Condition":
        """Read the list."""
        from reconstruction.session.conditions import SYNCED, Condition

        if isinstance(value, Condition):
            return value
        try:
            found = Condition.parse(str(value))
        except BadInputError:
            found = None
        if found is None or found.name == SYNCED:
            self.fail(f"{value!r} is not how late cameras are, as in cam00=0,cam01=66 or 0,66", param, ctx)
        return found
