"""Phones running unmodified libsoftwaresync or RecSync: their UDP ports and their part in bursts."""

import asyncio
from collections.abc import Callable, Sequence

from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.tasks import Background, has_come
from capture_app.common.text import count
from capture_app.companions.interop.app_leader import AppLeader
from capture_app.companions.interop.app_protocol import CALL_PORT, GOAL_PHASE_NS, PERIOD_NS, TIME_PORT
from capture_app.net.server import bind_datagrams
from capture_app.net.udp import Pump
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.followers import Follower
from capture_app.protocol.event_text import FollowerEvent
from capture_app.protocol.log import Log
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.status import FollowerStatus
from capture_app.sync.rig.frame_selection import MAX_FRAMES

LOOK_EVERY_S = 0.1
LEAD_NS = 500_000_000
"""Interval between an order and its first instant, as the app's own leader uses."""
RECORD = "record, if they have RecSync"


class AppPhones(Follower):
    """Follower that leads phones running the app between `start` and `close`."""

    def __init__(self, host: str, *, aligns: bool) -> None:
        """Listen on `host`. With `aligns`, phones align their phase to the grid that is fixed in the app.

        The rig must then use the app's grid, too.
        """
        self._host = host
        self.grid = (PERIOD_NS, GOAL_PHASE_NS) if aligns else None
        self._engine = AppLeader(aligns=aligns)
        self._pumps: list[Pump] = []
        self._recordings = Background()
        self._clock: NodeClock = HostClock()
        self._event_log = Log()

    def start(self, clock: NodeClock, event_log: Log) -> None:
        """Listen on the app's two ports. Raises NetworkError if they are in use."""
        self._clock, self._event_log = clock, event_log
        hint = "the app knows no other port: end the other program that uses it"
        calls = bind_datagrams(self._host, CALL_PORT, hint=hint)
        try:
            times = bind_datagrams(self._host, TIME_PORT, hint=hint)
        except NetworkError:
            calls.close()
            raise
        time_pump = Pump(self._engine.times, clock, lambda: None)
        call_pump = Pump(self._engine.calls, clock, lambda: self._after_call(time_pump))
        self._pumps = [call_pump, time_pump]
        time_pump.start(times)
        call_pump.start(calls)

    async def close(self) -> None:
        """Stop the phones' recordings and close both ports."""
        await self._recordings.end()
        for pump in self._pumps:
            pump.close()

    def statuses(self) -> tuple[FollowerStatus, ...]:
        """Return the status of all connected and recently lost phones."""
        return self._engine.statuses(self._clock.now_ns())

    def take_part(self, take: BurstSession) -> None:
        """Order a burst's stills or video from the connected phones."""
        if not (phones := len(self._engine.present())):
            return
        if take.burst.video:
            self._recordings.start(self._record(lambda: take.burst.instants_ns[-1], take.finished))
            self._log_order(phones, RECORD)
        else:
            self._log_order(phones, self._order(take.burst.instants_ns, take.burst.period_ns))

    def take_alone(self, request: BurstRequest) -> str:
        """Order a capture on a rig without cameras; return the order in words, empty without phones.

        Raises BadInputError for a recording without a duration: nothing else would end it.
        """
        if not (phones := len(self._engine.present())):
            return ""
        first_ns = request.at_leader_ns or self._clock.now_ns() + LEAD_NS
        # Instants are on the app's own grid.
        first_ns += (GOAL_PHASE_NS - first_ns) % PERIOD_NS
        step_ns = request.spacing * PERIOD_NS
        if request.interval_s is not None:
            step_ns = max(1, round(request.interval_s * 1e9 / PERIOD_NS)) * PERIOD_NS
        if not request.video:
            frames = request.frames or max(1, round((request.seconds or 0) * 1e9 / step_ns))
            instants_ns = [first_ns + n * step_ns for n in range(min(frames, MAX_FRAMES))]
            return self._log_order(phones, self._order(instants_ns, PERIOD_NS))
        if request.seconds is None:
            raise BadInputError(
                "phones alone record for a given time", hint="capture-app record --seconds 10"
            )
        last_ns = first_ns + round(request.seconds * 1e9)
        self._recordings.start(self._record(lambda: last_ns, asyncio.Event()))
        return self._log_order(phones, RECORD)

    def _order(self, instants_ns: Sequence[int], period_ns: int) -> str:
        taken = self._engine.order_stills(instants_ns, period_ns, self._clock.now_ns())
        return f"take {len(taken)} of {count(len(instants_ns), 'instant')}: one each half a second at most"

    def _log_order(self, phones: int, what: str) -> str:
        self._advance_burst()
        text = (
            f"{count(phones, 'phone')} with the app ordered to {what}; "
            "what they take stays on them (capture-app sessions import)"
        )
        self._event_log.note(FollowerEvent(None, text))
        return text

    def expose(self, exposure_ns: int, iso: int) -> None:
        """Set exposure time (ns) and sensitivity (ISO) of the connected phones."""
        self._engine.set_exposure(exposure_ns, iso)
        self._advance_burst()

    async def _record(self, ends_ns: Callable[[], int], finished: asyncio.Event) -> None:
        """Record on the phones until `ends_ns()` (leader time, may change) or until `finished` is set."""
        self._engine.record(True)
        self._advance_burst()
        try:
            while not finished.is_set() and self._clock.now_ns() <= ends_ns():
                await has_come(finished, LOOK_EVERY_S)
        finally:
            self._engine.record(False)
            self._advance_burst()

    def _advance_burst(self) -> None:
        for pump in self._pumps:
            pump.turn()

    def _after_call(self, time_pump: Pump) -> None:
        while (event := self._engine.next_event()) is not None:
            self._event_log.note(event)
            # A new phone needs its first clock request now.
            time_pump.turn()
