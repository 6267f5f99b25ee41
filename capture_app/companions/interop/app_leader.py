"""Leader side of the phone app's protocol: heartbeats, clock exchanges, offset updates and triggers.

The app's own leader sets each phone's offset once an hour and does not model skew. This leader sends a new
offset every second, extrapolated to half a second ahead.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from capture_app.common.names import name_like
from capture_app.common.text import duration
from capture_app.companions.interop.app_protocol import (
    CALL_PORT,
    TIME_ANSWER,
    TIME_PORT,
    TIME_REQUEST,
    AppOrders,
    AppPhone,
    CallMethod,
    decode_call,
    encode_call,
    heartbeat_name,
)
from capture_app.protocol.event_text import FollowerEvent
from capture_app.protocol.status import FollowerStatus
from capture_app.sync.clock.time_map import TimeMap

Address = tuple[str, int]
MAX_PHONES = 32
REPORT_INTERVAL_NS, ALIGN_EVERY_NS = 1_000_000_000, 5_000_000_000
SILENT_NS, FORGOTTEN_NS = 5_000_000_000, 60_000_000_000
EXCHANGES_PER_S = 1000.0
"""Maximum rate of clock exchanges, over all phones together."""


@dataclass(frozen=True, slots=True)
class _Port:
    """Protocol engine of one of the two UDP ports, in the form that `net.udp.Pump` drives."""

    receive_datagram: Callable[[bytes, Address, int], None]
    datagrams_to_send: Callable[[int], list[tuple[bytes, Address]]]
    next_timer: Callable[[], int | None]
    handle_timer: Callable[[int], None]


class AppLeader:
    """Leader of phones that run the app, with one engine per UDP port; `now_ns` is the leader's clock."""

    def __init__(self, *, aligns: bool) -> None:
        """With `aligns`, order phones at intervals to align their phase to the app's fixed target."""
        self.calls = _Port(self._receive_call, self._calls_to_send, self._next_timer, self._handle_timer)
        self.times = _Port(self._receive_answer, self._ask, self._next_request, self._prepare_requests)
        self.orders = AppOrders()
        self._aligns = aligns
        self._phones: dict[str, AppPhone] = {}
        self._out: list[tuple[bytes, Address]] = []
        self._events: deque[FollowerEvent] = deque()

    def order_stills(self, instants_ns: Sequence[int], period_ns: int, now_ns: int) -> tuple[int, ...]:
        """Order a still from all phones at the instants that the app can serve, and return those instants."""
        return self.orders.add_stills(instants_ns, period_ns, now_ns) if self.present() else ()

    def record(self, is_recording: bool) -> None:
        """Order phones with RecSync to start or stop a video; not repeated, as the app cannot handle it."""
        self.orders.is_recording = is_recording
        self._call_all(CallMethod.START_RECORDING if is_recording else CallMethod.STOP_RECORDING)

    def set_exposure(self, exposure_ns: int, iso: int) -> None:
        """Set exposure time (ns) and sensitivity (ISO) of all phones."""
        self._call_all(CallMethod.SET_EXPOSURE, f"{exposure_ns},{iso}")

    def present(self) -> list[AppPhone]:
        """Return the connected phones."""
        return [phone for phone in self._phones.values() if not phone.lost]

    def statuses(self, now_ns: int) -> tuple[FollowerStatus, ...]:
        """Return the status of all connected and recently lost phones, sorted by name."""
        return tuple(_status(phone, now_ns) for phone in sorted(self._phones.values(), key=lambda p: p.name))

    def next_event(self) -> FollowerEvent | None:
        """Return the next pending event, or None."""
        return self._events.popleft() if self._events else None

    # Engines of the two ports

    def _receive_call(self, data: bytes, address: Address, now_ns: int) -> None:
        """Handle a received call; heartbeats are the only calls that a phone may send."""
        host, (method, text) = address[0], decode_call(data) or (0, "")
        name = heartbeat_name(text) if method == CallMethod.HEARTBEAT else None
        phone = self._phones.get(host)
        if name is None or (phone is None and len(self._phones) >= MAX_PHONES):
            return
        if phone is None or phone.lost:
            phone = self._phones[host] = AppPhone(self._free_name(name, host), host, now_ns)
            what = f"phone {phone.name} at {host} joined with the Android app, which needs no pairing"
            self._events.append(FollowerEvent(phone.name, what))
            self._set_interval()
        phone.last_heard_ns = now_ns
        # Reply to the sender's address: the address in the heartbeat may belong to another of its networks.
        self._out.append((encode_call(CallMethod.HEARTBEAT_ACK, text), (host, CALL_PORT)))

    def _receive_answer(self, data: bytes, address: Address, now_ns: int) -> None:
        """Handle a phone's reply to a time request, received at `now_ns`."""
        phone = self._phones.get(address[0])
        if phone is not None and not phone.lost and len(data) == TIME_ANSWER.size:
            t0_ns, t1_ns, t2_ns = TIME_ANSWER.unpack(data)
            phone.take_answer(t0_ns, t1_ns, t2_ns, now_ns)

    def _ask(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the due time requests, stamped with `now_ns`."""
        request = TIME_REQUEST.pack(now_ns)
        return [(request, (phone.host, TIME_PORT)) for phone in self.present() if phone.take_request(now_ns)]

    def _next_request(self) -> int | None:
        """Return the leader time (ns) of the next clock request, or None."""
        return min((phone.next_timer() for phone in self.present()), default=None)

    def _prepare_requests(self, now_ns: int) -> None:
        """Prepare the time requests to all phones that are due."""
        for phone in self.present():
            phone.handle_timer(now_ns)

    def _calls_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the queued calls, each as a datagram with its phone's address."""
        out, self._out = self._out, []
        return out

    def _handle_timer(self, now_ns: int) -> None:
        """Send offsets and phase alignment, repeat triggers, and detect lost phones."""
        for phone in list(self._phones.values()):
            silent_ns = now_ns - phone.last_heard_ns
            if silent_ns >= FORGOTTEN_NS:
                del self._phones[phone.host]
            elif silent_ns >= SILENT_NS and not phone.lost:
                phone.lost = True
                self._events.append(
                    FollowerEvent(phone.name, f"lost phone {phone.name}: it has gone silent", is_warning=True)
                )
                self._set_interval()
            elif not phone.lost and phone.synced and now_ns >= (phone.report_due_ns or now_ns):
                self._send_trigger(phone, now_ns)
        for trigger_ns in self.orders.triggers_due(now_ns):
            self._call_all(CallMethod.SET_TRIGGER_TIME, str(trigger_ns))

    def _next_timer(self) -> int | None:
        """Return the leader time (ns) at which `_handle_timer` is next due, or None."""
        due = [
            phone.last_heard_ns + (FORGOTTEN_NS if phone.lost else SILENT_NS)
            for phone in self._phones.values()
        ]
        due += [phone.report_due_ns or 0 for phone in self.present() if phone.synced]
        due += self.orders.stills.values()
        return min(due, default=None)

    def _send_trigger(self, phone: AppPhone, now_ns: int) -> None:
        assert phone.time_map is not None, "a synced phone has a map"
        middle_ns = now_ns + REPORT_INTERVAL_NS // 2
        self._call(
            phone, CallMethod.OFFSET_UPDATE, str(phone.time_map.leader_from_local(middle_ns) - middle_ns)
        )
        if phone.report_due_ns is None:
            text = f"phone {phone.name} has the time to {duration(_uncertainty_ns(phone, now_ns) or 0.0)}"
            self._events.append(FollowerEvent(phone.name, text))
            phone.align_due_ns = now_ns + REPORT_INTERVAL_NS
        phone.report_due_ns = now_ns + REPORT_INTERVAL_NS
        if self._aligns and now_ns >= phone.align_due_ns and self.orders.may_align(now_ns):
            self._call(phone, CallMethod.DO_PHASE_ALIGN)
            phone.align_due_ns = now_ns + ALIGN_EVERY_NS

    def _call(self, phone: AppPhone, method: CallMethod, text: str = "") -> None:
        self._out.append((encode_call(method, text), (phone.host, CALL_PORT)))

    def _call_all(self, method: CallMethod, text: str = "") -> None:
        for phone in self.present():
            self._call(phone, method, text)

    def _set_interval(self) -> None:
        for phone in self.present():
            phone.limit_requests(round(len(self.present()) * 1e9 / EXCHANGES_PER_S))

    def _free_name(self, name: str, host: str) -> str:
        name = name_like(name, "phone")
        others = {phone.name for phone in self._phones.values() if phone.host != host}
        return name if name not in others else name_like(f"{name}-{host}", "phone")


def _uncertainty_ns(phone: AppPhone, now_ns: int) -> float | None:
    """Return the 95 % uncertainty of a phone's leader time, half a second from its offset's reference."""
    time_map = phone.time_map if phone.synced else None
    return None if time_map is None else time_map.uncertainty_at(now_ns) + _slack_ns(time_map)


def _slack_ns(time_map: TimeMap) -> float:
    """Return the drift of a phone's clock in half a second, between two offsets."""
    return abs(time_map.skew) * REPORT_INTERVAL_NS / 2.0


def _status(phone: AppPhone, now_ns: int) -> FollowerStatus:
    status = FollowerStatus(
        name=phone.name,
        address=phone.host,
        state="lost" if phone.lost else "synced" if phone.synced else "synchronizing",
        samples=phone.samples,
        last_seen_ns=now_ns - phone.last_heard_ns,
    )
    time_map, uncertainty_ns = phone.time_map, _uncertainty_ns(phone, now_ns)
    if time_map is None or uncertainty_ns is None:
        return status
    return replace(
        status,
        uncertainty_ns=round(uncertainty_ns),
        hard_bound_ns=round(time_map.hard_bound_at(now_ns) + _slack_ns(time_map)),
        skew_ppm=time_map.skew * 1e6,
        round_trip_ns=time_map.round_trip_ns,
    )
