"""The paper's tables and ours, each a command: one module per experiment, imported when it runs."""

from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture_app.experiments.common.result import Outcome

EXPERIMENTS: dict[str, str] = {
    "clock-filters": "Clock estimators under seven delay distributions: mean, minimum, ours.",
    "scale": "Thousands of clocks for an hour: one leader, and a tree of relays.",
    "link": "The engine's own clock and other filters on a real link between two processes.",
    "led-panel": "Total error, read from pictures of the paper's LED panel.",
    "reference-broadcast": "Differences between clients with and without common beacons.",
    "naive": "Triggering without synchronization, as in the paper, and with it.",
    "phase": "Frame injections, restarts and frame durations that phase alignment takes.",
}
"""Name and what it shows; its room has the same name, with underscores."""


class Experiment(Protocol):
    """What the module of an experiment offers."""

    def run(self, *, trials: "int | None", seed: int, talk: "Callable[[str], None]") -> "Outcome":
        """Run it; `trials` None means its own default, `talk` takes a line about progress."""


def load(name: str) -> Experiment:
    """Import an experiment; raises KeyError for a name that is not in the table."""
    if name not in EXPERIMENTS:
        raise KeyError(name)
    return cast(Experiment, import_module(f"capture_app.experiments.{name.replace('-', '_')}.experiment"))
