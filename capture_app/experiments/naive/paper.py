"""Table I of the paper: triggers without synchronization."""

from collections.abc import Callable, Sequence

from capture_app.experiments.common.paper_values import TABLE_1
from capture_app.experiments.common.reproduction import Measured, Reproduction, share_of
from capture_app.experiments.naive.experiment import FIGURES, NOTES, TRIALS, draw_sizes, figures_of


def paper_part(*, share: float, seed: int, talk: Callable[[str], None]) -> Sequence[Reproduction]:
    """Set what known mechanisms explain beside what the paper measured."""
    count = share_of(TRIALS, share, least=200)
    talk(f"{count} triggers of each kind")
    sizes_ms = {name: sizes for name, sizes in draw_sizes(str(seed), count).items() if name != "usb"}
    values = {
        f"{name}.{theirs}": figures_of(sizes)[ours]
        for name, sizes in sizes_ms.items()
        for ours, theirs in FIGURES.items()
    }
    return [
        Reproduction(
            of=TABLE_1,
            seed=seed,
            protocol=Measured(values, count, "only mechanisms with published numbers"),
            default=None,
            simulated="Everything: no phone was triggered. The paper's figures stand as it gives them.",
            notes=NOTES[:2],
        )
    ]
