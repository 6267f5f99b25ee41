"""The triggers that a leader has out, until each client has answered its own or is given up."""

from dataclasses import dataclass

from capture_app.sync.events import BurstAccepted, BurstRefused
from capture_app.sync.messages import Trigger, TriggerAck
from capture_app.sync.roster import Member

_MS = 1_000_000
TRIGGER_AGAIN_NS = 50 * _MS
TRIGGER_GIVE_UP_NS = 5000 * _MS


@dataclass(slots=True)
class _Order:
    """A trigger that a client has not answered yet."""

    member: Member
    trigger: Trigger
    give_up_ns: int
    due_ns: int = 0


class Orders:
    """Triggers on their way, each sent again and again; `now_ns` is leader time."""

    def __init__(self) -> None:
        self._orders: list[_Order] = []

    def add(self, member: Member, trigger: Trigger, now_ns: int) -> None:
        """Order a burst of a member: the trigger is due at once."""
        self._orders.append(_Order(member, trigger, now_ns + TRIGGER_GIVE_UP_NS))

    def take_ack(self, member: Member, ack: TriggerAck) -> BurstAccepted | BurstRefused | None:
        """Take in a member's answer; None where it has been answered, or given up, before."""
        for order in self._orders:
            if order.member is member and order.trigger.burst == ack.burst:
                self._orders.remove(order)
                if ack.refusal:
                    return BurstRefused(member.name, ack.burst, ack.refusal)
                return BurstAccepted(member.name, ack.burst)
        return None

    def give_up(self, now_ns: int) -> list[BurstRefused]:
        """Drop the orders of members that are lost, or have not answered for too long."""
        refused = []
        for order in list(self._orders):
            if order.member.lost or now_ns >= order.give_up_ns:
                self._orders.remove(order)
                reason = order.member.lost or "it does not answer"
                refused.append(BurstRefused(order.member.name, order.trigger.burst, reason))
        return refused

    def due(self, now_ns: int) -> list[tuple[Member, Trigger]]:
        """Return the triggers to be sent now, for the first time or again, and whom to."""
        due = [order for order in self._orders if now_ns >= order.due_ns]
        for order in due:
            order.due_ns = now_ns + TRIGGER_AGAIN_NS
        return [(order.member, order.trigger) for order in due]

    def next_timer(self) -> int | None:
        """Leader time in ns at which a trigger is to be sent, None for never."""
        return min((order.due_ns for order in self._orders), default=None)
