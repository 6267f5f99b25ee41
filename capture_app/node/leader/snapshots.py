"""Conversion of an engine's roster to the status for people and programs: a tree of nodes."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from msgspec.structs import asdict, replace

from capture_app.common.address import Address
from capture_app.common.bounds import cut
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.text import count
from capture_app.protocol.messages import SpoolSpace
from capture_app.protocol.orders import CameraHealth
from capture_app.protocol.status import NodeStatus
from capture_app.sync.rig.roster import Member, relays_above
from capture_app.sync.wire.datagrams import Report

MAX_PER_PAGE = 250


def node_statuses(
    members: tuple[Member, ...],
    all_members: tuple[Member, ...] | None = None,
    *,
    now_ns: int,
    health: Mapping[str, CameraHealth] | None = None,
    spools: Mapping[str, SpoolSpace] | None = None,
    local: Collection[str] = (),
) -> tuple[NodeStatus, ...]:
    """Return the statuses of `members`, with their parents among `all_members`.

    `local` names the nodes that are processes of the leader's machine.
    """
    by_name = {member.name: member for member in all_members or members}
    known = spools or {}
    return tuple(
        NodeStatus(
            **asdict(_with_disk(member.report, known.get(member.name))),
            **asdict((health or {}).get(member.name, CameraHealth())),
            disk_free_bytes=space.free_bytes if (space := known.get(member.name)) else None,
            on_leader=member.name in local,
            name=member.name,
            address=str(Address(*member.address)),
            camera=member.camera,
            parent=member.via,
            depth=1 + max(len([*relays_above(member, by_name)]), member.via is not None),
            last_seen_ns=now_ns - member.last_heard_ns,
        )
        for member in members
    )


def page_of(members: tuple[Member, ...], after: str | None) -> tuple[tuple[Member, ...], int, str]:
    """Return a page of nodes after the name `after`, the number of further nodes, and a summary of those.

    With `after` None the page has all nodes. A page is short enough for a message.
    """
    if after is None:
        return members, 0, ""
    rest = members[bisect_right(members, after, key=lambda member: member.name) :] if after else members
    page, further = rest[:MAX_PER_PAGE], rest[MAX_PER_PAGE:]
    states = Counter(str(member.report.state) for member in further)
    words = ", ".join(f"{number} {state}" for state, number in sorted(states.items()))
    text = f"and {count(len(further), 'more node')}, not listed here: {words}" if further else ""
    return page, len(further), text


def _with_disk(report: Report, space: SpoolSpace | None) -> Report:
    """Return a node's report, with its disk's problem if it has no other message."""
    if space is None or not space.problem or report.message or report.state is NodeState.LOST:
        return report
    return replace(report, message=cut(space.problem))


def present_cameras(members: Sequence[Member]) -> list[Member]:
    """Return the nodes that are not lost and have a camera."""
    return [
        member
        for member in members
        if member.report.state is not NodeState.LOST and member.camera.kind not in WITHOUT_CAMERA
    ]
