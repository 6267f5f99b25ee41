"""One sentence for the whole rig: what keeps it from being ready and what to do, or how accurate it is."""

from collections.abc import Callable, Mapping, Sequence

from capture_app.host_rate import HostRate
from capture_app.node.leader.readiness import shortfall
from capture_app.node.leader.snapshots import present_cameras
from capture_app.node.leader.wording import off_rate_line
from capture_app.node.wire.status import LOST_IS_NEWS_NS
from capture_app.session.reading.stamp_words import unmeasured_stamps
from capture_app.sync.rig.roster import ClientView
from capture_app.sync.timekeeping.rate_jury import LEADER, HostAtRate, HostOffRate, RateJury
from capture_app.sync.wire.messages import NodeState
from capture_app.text import count, duration

REVIEW_EVERY_NS = 1_000_000_000
"""Between two looks at which clocks run oddly."""
_GONE = (NodeState.FAILED, NodeState.LOST)
_ON_THE_WAY = (
    NodeState.JOINING,
    NodeState.SYNCING,
    NodeState.ALIGNING,
    NodeState.COARSE,
)
"""Where several nodes are not ready, the one that waits longest for a person is spoken of."""
_CLOCK_IS_KNOWN = (NodeState.ALIGNING, NodeState.COARSE, NodeState.READY)


class RateReview:
    """Looks now and then at which clocks run oddly, the leader's host among them."""

    def __init__(self) -> None:
        self._host_rate, self._jury = HostRate(), RateJury()
        self._due_ns: int | None = None

    @property
    def off(self) -> Mapping[str | None, HostOffRate]:
        """Those that do, by name."""
        return self._jury.off

    def look(self, views: Callable[[], Sequence[ClientView]], now_ns: int) -> list[HostOffRate | HostAtRate]:
        """Look where it is time to; return what is news."""
        if self._due_ns is not None and now_ns < self._due_ns:
            return []
        self._due_ns = now_ns + REVIEW_EVERY_NS
        return review_rates(self._jury, views(), self._host_rate.slewing_ppm(now_ns))


def review_rates(
    jury: RateJury, views: Sequence[ClientView], leader_slewing_ppm: float | None
) -> list[HostOffRate | HostAtRate]:
    """Let the jury judge all clocks by what their nodes report; return what is news."""
    known = [view for view in views if view.report.state in _CLOCK_IS_KNOWN]
    # A skew is that of the leader's clock against the node's.
    rates_ppm = {view.name: -view.report.skew_ppm for view in known if view.report.skew_ppm is not None}
    slewing_ppm: dict[str | None, float] = {
        view.name: view.report.slewing_ppm for view in known if view.report.slewing_ppm
    }
    if leader_slewing_ppm:
        slewing_ppm[LEADER] = leader_slewing_ppm
    return jury.review(rates_ppm, slewing_ppm)


def rig_advice(
    views: Sequence[ClientView], leader: str, off_rate: Mapping[str | None, HostOffRate] | None = None
) -> str:
    """Return the one sentence; `leader` is where nodes join, `off_rate` are the hosts with odd clocks."""
    sentence = _of_states(views, _GONE)
    if not sentence and off_rate:
        worst = max(off_rate.values(), key=lambda off: (off.certain, abs(off.fast_ppm)))
        sentence = off_rate_line(worst) + _and_more(len(off_rate))
    if sentence := sentence or _of_states(views, _ON_THE_WAY):
        return sentence
    cameras = present_cameras(views)
    if not cameras:
        return f"no camera is here: start one with capture-app node --leader {leader} --camera SPEC"
    bars_ns = [view.report.uncertainty_ns for view in cameras if view.report.uncertainty_ns is not None]
    sure = f", clocks sure to ±{duration(max(bars_ns))} (95 %)" if bars_ns else ""
    facts = {view.name: view.camera for view in cameras}
    if unsure := unmeasured_stamps(facts):
        sure += f"; {unsure}"
    elif stamps_ns := max(one.stamp_accuracy.uncertainty_ns for one in facts.values()):
        sure += f", stamps to ±{duration(stamps_ns)}"
    return f"{count(len(cameras), 'camera')} ready{sure}"


def _of_states(views: Sequence[ClientView], states: Sequence[NodeState]) -> str:
    for state in states:
        concerned = [view for view in views if view.report.state is state and not _is_old_loss(view)]
        if concerned:
            return shortfall(concerned[0], why=True) + _and_more(len(concerned))
    return ""


def _is_old_loss(view: ClientView) -> bool:
    return view.report.state is NodeState.LOST and view.age_ns > LOST_IS_NEWS_NS


def _and_more(all_of_them: int) -> str:
    return "" if all_of_them == 1 else f" (and {count(all_of_them - 1, 'more node')})"
