"""How well anybody could know a clock from the same messages: an oracle that is told the link's laws.

It knows both ways' laws of delay, floors included, and the rates of both clocks: all but the offset. The mean
of its posterior (flat prior) has the least mean square error of all estimators there are.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.links import DelayLaw, GammaDelay, Link

Floats = NDArray[np.float64]
REACH_NS, STEP_NS = 250_000, 500
"""Offsets that are tried, to both sides of the truth."""


def oracle_error_ns(to_leader_ns: Sequence[int], to_client_ns: Sequence[int], link: Link) -> float:
    """Error in ns of the posterior mean of a client's offset, by the true delays of messages of both ways.

    The link's laws are Gamma of shape 2; of its quick moments nothing is made. An offset off by x makes
    each way to the leader longer by x, and each way back shorter. Messages that came late by an outlier's
    law say nothing, and are left out.
    """
    offs_ns = np.arange(-REACH_NS, REACH_NS + 1, STEP_NS, dtype=np.float64)
    scores = _log_likelihood(to_leader_ns, link.to_leader, offs_ns)
    scores += _log_likelihood(to_client_ns, link.to_client, -offs_ns)
    weights = np.exp(scores - scores.max())
    return float(weights @ offs_ns / weights.sum())


def minimum_filter_error_ns(to_leader_ns: Sequence[int], to_client_ns: Sequence[int]) -> float:
    """Error in ns of the paper's estimator on the same messages: that of the least round trip."""
    there, back = min(zip(to_leader_ns, to_client_ns, strict=True), key=sum)
    return (there - back) / 2


def _log_likelihood(delays_ns: Sequence[int], law: DelayLaw, offs_ns: Floats) -> Floats:
    """Log-likelihoods, but for a constant, of Gamma delays of shape 2 that seem longer by so much."""
    assert isinstance(law, GammaDelay)
    scale_ns = (law.mean_ns - law.minimum_ns) / 2.0
    kept_ns = [ns for ns in delays_ns if not ns > law.outlier_from_ns > 0]
    excess_ns = np.array(kept_ns, dtype=np.float64)[None, :] + offs_ns[:, None] - law.minimum_ns
    possible = np.maximum(excess_ns, 1e-300)
    scores: Floats = np.sum(np.log(possible) - possible / scale_ns, axis=1)
    return scores
