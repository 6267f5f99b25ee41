"""How far an offset that was found is from the truth."""

from capture_app.session.format.common_times import CameraTimes
from tests.unit.plugins.footage.cut_apart import Phone

PHONES = (
    Phone("a", start_s=0.0, fps=30),
    Phone("b", start_s=1.2345, fps=30_000 / 1001, ppm=30, seed=2),
    Phone("c", start_s=-0.8177, fps=30, ppm=-25, jitter_s=0.012, seed=3),
)


def error_ms(times: CameraTimes, phone: Phone, at_s: float) -> tuple[float, float]:
    """How wrong the aligned time is at the phone's own time, against phone a, and its 95 % error."""
    own_ns = round(at_s * 1e9)
    true_s = float(PHONES[0].own_s(phone.true_s(at_s)))
    bar_ns = times.uncertainty_at_ns(own_ns)
    assert bar_ns is not None
    return times.leader_from_local(own_ns) / 1e6 - true_s * 1e3, bar_ns / 1e6
