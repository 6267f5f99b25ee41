"""The link of the paper, with its delays under several laws."""

from capture_app.simulation.network.delay_laws import DelayLaw, GammaDelay, LognormalDelay
from capture_app.simulation.network.link import Link

_US = 1_000
PAPER_LINK = Link(
    to_leader=GammaDelay(479 * _US, 1878 * _US, outlier_share=0.0064),
    to_client=GammaDelay(517 * _US, 1133 * _US, outlier_share=0.0064),
)
"""WiFi as the paper measured it (section 4); the Gamma shape is an assumption."""


def paper_link(shape: float | None = None, sigma: float | None = None, loss: float = 0.0) -> Link:
    """Return the paper's link with another law of delays: Gamma of a shape, or lognormal of a sigma."""

    def law(minimum_ns: int, mean_ns: int) -> DelayLaw:
        if sigma is not None:
            return LognormalDelay(minimum_ns, mean_ns, sigma, 0.0064)
        return GammaDelay(minimum_ns, mean_ns, 2.0 if shape is None else shape, 0.0064)

    return Link(law(479 * _US, 1878 * _US), law(517 * _US, 1133 * _US), loss)


LINKS_BY_LAW: dict[str, Link] = {
    "gamma 1": paper_link(shape=1.0),
    "gamma 1.5": paper_link(shape=1.5),
    "gamma 2": paper_link(shape=2.0),
    "gamma 3": paper_link(shape=3.0),
    "lognormal 0.6": paper_link(sigma=0.6),
    "lognormal 1.0": paper_link(sigma=1.0),
}
"""The paper's minimum and mean delays under six laws; the paper gives none."""
