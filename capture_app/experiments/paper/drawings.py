"""Figures 3 and 4: what the paper draws by hand, drawn from simulated messages and frames."""

from collections.abc import Callable, Sequence

from capture_app.experiments.common.reproduction import Reproduction
from capture_app.experiments.paper import handshake, strategies


def paper_part(*, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
    """Draw both; each shows single messages and cameras, whatever the share."""
    return [handshake.reproduce(seed), strategies.reproduce(seed)]
