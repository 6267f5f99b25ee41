"""The link of the paper, with its delays under several laws."""

from capture_app.simulation.network.delay_laws import DelayLaw, GammaDelay, LognormalDelay
from capture_app.simulation.network.link import Link


def paper_link(shape: float = 2.0, sigma: float | None = None) -> Link:
    """Return WiFi as the paper measured it (section 4), Gamma of a shape or else lognormal of a sigma."""

    def law(minimum_ns: int, mean_ns: int) -> DelayLaw:
        if sigma is not None:
            return LognormalDelay(minimum_ns, mean_ns, sigma, outlier_share=0.0064)
        return GammaDelay(minimum_ns, mean_ns, shape, outlier_share=0.0064)

    return Link(to_leader=law(479_000, 1_878_000), to_client=law(517_000, 1_133_000))


PAPER_LINK = paper_link()
"""The link of the paper; the Gamma shape is an assumption."""
LINKS_BY_LAW: dict[str, Link] = {
    "gamma 1": paper_link(shape=1.0),
    "gamma 1.5": paper_link(shape=1.5),
    "gamma 2": paper_link(shape=2.0),
    "gamma 3": paper_link(shape=3.0),
    "lognormal 0.6": paper_link(sigma=0.6),
    "lognormal 1.0": paper_link(sigma=1.0),
}
"""The paper's minimum and mean delays under six laws; the paper gives none."""
