"""Leader of phones with libsoftwaresync on a rig's time, by the app's own protocol.

Written from google-research/libsoftwaresync: softwaresync/SyncConstants.java, SoftwareSyncBase.java and
SntpListener.java, and SoftwareSyncController.java for the methods from 200,000 on. A call is a big-endian
32-bit method number and a text up to the end of the datagram; time messages are big-endian 64-bit times in
ns. Nothing is authenticated, and only heartbeats are acknowledged.
"""

import asyncio
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass

from capture_app.common.host_clock import host_ns
from capture_app.common.names import name_like
from capture_app.common.text import Talk, count, duration
from capture_app.protocol.status import RigStatus
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample

CALL_PORT, TIME_PORT = 8244, 9428
"""The app's ports: every message goes to one of them, whatever port the other end sent from."""
ACK, OFFSET, TRIGGER, ALIGN = 2, 3, 200_000, 200_001
METHOD, REQUEST, ANSWER = struct.Struct(">i"), struct.Struct(">q"), struct.Struct(">qqq")
HEARTBEAT = re.compile(rb"\x00\x00\x00\x01([^,]{1,64}),[^,]{0,64},(?:true|false)")
"""Method 1: name, IPv4 address, whether it is synchronized. The address may belong to another network."""
PERIOD_NS, GOAL_NS, SAME_PERIOD_NS = 33_320_000, 15_000_000, 20
"""The app's frame period, its goal of leader time modulo that (res/raw/default_phaseconfig.json), and how far
a rig's period may be from it: its frames then move away by 0.6 us a second."""
SAMPLES, MAX_PHONES, SILENT_NS, SOON_NS, LATE_NS = 300, 16, 5_000_000_000, 2_000_000_000, 120_000_000
"""Clock exchanges before a phone gets the time, as in the paper's minimum filter; most phones; time until a
phone is lost; and time before an instant from which on, and until which, its trigger is sent. It is repeated,
as it may be lost; one that came after its frame would save a second one."""


@dataclass(slots=True)
class _Phone:
    name: str
    clock: ClockFilter
    """Estimator of its clock, as if it were the leader's, from this machine's."""
    heard_ns: int = 0
    error_ns: float | None = None
    """95 % error of the rig's time in it; None until it was sent."""


class AppLeader(asyncio.DatagramProtocol):
    """Leader of phones; both of the app's ports belong to it."""

    def __init__(self, say: Talk, now_ns: Callable[[], int] = host_ns) -> None:
        """`say` gets a line for people about each change; `now_ns` is this machine's clock."""
        self.rig_clock, self.epoch_ns, self._aligns = ClockFilter(), 0, False
        """Estimator of the rig's time, whose samples are the caller's to add; the phones' leader time less
        the rig's, which puts the app's goal on the rig's instants; and whether phones may move now."""
        self.phones: dict[str, _Phone] = {}
        self.send: Callable[[bytes, tuple[str, int]], None]
        """Sends a datagram; the caller sets it."""
        self._say, self._now_ns, self._said = say, now_ns, dict[str, object]()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Take in a heartbeat or an answer to a clock request, and nothing else."""
        now_ns, host, heartbeat = self._now_ns(), addr[0], HEARTBEAT.fullmatch(data)
        if heartbeat is not None and (host in self.phones or len(self.phones) < MAX_PHONES):
            self.phones.setdefault(
                host, _Phone(name_like(heartbeat[1].decode(errors="replace"), "phone"), ClockFilter())
            ).heard_ns = now_ns
            self._call(host, ACK, data[METHOD.size :])
        elif host in self.phones and len(data) == ANSWER.size:
            self.phones[host].clock.add(ClockSample(*(*ANSWER.unpack(data), now_ns)))

    def see_rig(self, rig: RigStatus) -> None:
        """Put the phones' goal on the rig's instants where the periods agree, and send the next trigger.

        The app saves the first frame at or after a trigger. That is half a period before a burst's first
        instant, so that no phone takes a frame a period off.
        """
        bursts = [of for of in (rig.burst, *rig.ahead) if of is not None and not of.done]
        grid_ns = [
            node.frame_leader_ns - node.phase_error_ns
            for node in rig.nodes
            if node.frame_leader_ns is not None and node.phase_error_ns is not None
        ]
        if rig.period_ns is not None and grid_ns:
            is_same = abs(rig.period_ns - PERIOD_NS) <= SAME_PERIOD_NS
            # Of the epochs that are a period apart, the nearest: the time in the phones does not jump.
            self.epoch_ns -= (
                (grid_ns[0] + self.epoch_ns - GOAL_NS + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2
                if is_same
                else self.epoch_ns
            )
            self._aligns = is_same and not bursts
            self._note(
                "phase",
                is_same,
                "phones move their frames onto the rig's instants, by the app's rule for a Pixel 3"
                if is_same
                else "phones save frames up to 17 ms from the rig's instants, as its period is"
                f" {rig.period_ns / 1e6:.2f} ms and theirs {PERIOD_NS / 1e6:.2f} ms: use leader --fps 30.012",
            )
        # A trigger replaces the one before, so the next waits until that frame is saved.
        # A trigger replaces the one before, so the next waits until that frame is saved.
        burst = min(
            (of for of in bursts if -LATE_NS <= of.first_leader_ns - rig.now_ns <= SOON_NS),
            key=lambda of: of.first_leader_ns,
            default=None,
        )
        if burst is not None and burst.first_leader_ns - rig.now_ns >= LATE_NS:
            hosts = [host for host, phone in self.phones.items() if phone.error_ns is not None]
            for host in hosts:
                self._call(host, TRIGGER, b"%d" % (burst.first_leader_ns - PERIOD_NS // 2 + self.epoch_ns))
            self._note(
                "burst",
                burst.name,
                f"{burst.name}: {count(len(hosts), 'phone')} to save one frame, which stays there; import it"
                f" by: capture-app sessions import FOLDER --time-shift-ms PHONE={-self.epoch_ns / 1e6:.6f}",
            )

    def send_time(self) -> None:
        """Send each phone its offset, right half a second from now, and forget silent phones."""
        now_ns = self._now_ns()
        middle_ns, rig = now_ns + 500_000_000, self.rig_clock.time_map(now_ns)
        self.phones = {h: phone for h, phone in self.phones.items() if now_ns - phone.heard_ns <= SILENT_NS}
        for host, phone in self.phones.items():
            clock = phone.clock.time_map(now_ns)
            if rig is not None and clock is not None and phone.clock.samples >= SAMPLES:
                offset_ns = clock.leader_from_local(middle_ns) - rig.leader_from_local(middle_ns)
                self._call(host, OFFSET, b"%d" % (offset_ns - self.epoch_ns))
                phone.error_ns = clock.uncertainty_at(now_ns) + rig.uncertainty_at(now_ns)
                if self._aligns:
                    self._call(host, ALIGN)
        self._note(
            "phones",
            [(host, phone.error_ns is None) for host, phone in sorted(self.phones.items())],
            "; ".join(
                f"phone {phone.name} at {host} "
                + (
                    "synchronizes"
                    if phone.error_ns is None
                    else f"has the rig's time ±{duration(phone.error_ns)}"
                )
                for host, phone in sorted(self.phones.items())
            )
            or "no phone is here",
        )

    def _call(self, host: str, method: int, text: bytes = b"") -> None:
        self.send(METHOD.pack(method) + text, (host, CALL_PORT))

    def _note(self, topic: str, what: object, line: str) -> None:
        if self._said.get(topic) != what:
            self._said[topic] = what
            self._say(line)
