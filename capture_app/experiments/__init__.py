"""The paper's tables and ours, each a command: one module per experiment, imported when it runs."""

from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture_app.experiments.common.result import Outcome

EXPERIMENTS: dict[str, str] = {
    "clock-filters": "Clock estimators under six laws of delay: mean, minimum, ours.",
    "scale": "Thousands of clocks for an hour: one leader beside a tree of relays.",
    "link": "The same estimators on a real link, between two processes.",
    "led-panel": "The whole chain, read off pictures of the paper's LED panel.",
    "reference-broadcast": "Clients that hear the same packets: how far apart, with it and without.",
    "naive": "Triggers without synchronization, modelled from the paper, against the chain.",
    "phase": "Injections, restarts, frame durations: how many, how long, beside the paper's way.",
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
