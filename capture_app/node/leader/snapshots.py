"""Conversion of an engine's roster to the status for people and programs: a tree of nodes."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import msgspec
from msgspec.structs import asdict, replace

from capture_app.common.address import Address
from capture_app.common.bounds import cut
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.text import count
from capture_app.net.channel import MAX_HEADER_BYTES
from capture_app.protocol.messages import SpoolSpace
from capture_app.protocol.orders import CameraHealth
from capture_app.protocol.status import BurstStatus, NodeStatus, RigStatus
from capture_app.sync.rig.roster import Member, relays_above
from capture_app.sync.wire.datagrams import Report

MAX_PER_PAGE = 250
MAX_STATUS_BYTES, MAX_BURST_BYTES = MAX_HEADER_BYTES * 3 // 4, MAX_HEADER_BYTES // 4
MAX_BURST_TEXT = 4_000


def node_statuses(
    members: tuple[Member, ...],
    all_members: tuple[Member, ...] | None = None,
    *,
    now_ns: int,
    health: Mapping[str, CameraHealth] | None = None,
    spools: Mapping[str, SpoolSpace] | None = None,
    local: Mapping[str, str] | None = None,
) -> tuple[NodeStatus, ...]:
    """Return the statuses of `members`, with their parents among `all_members`.

    `local` are the specs of the nodes that are processes of the leader's machine, by name.
    """
    by_name = {member.name: member for member in all_members or members}
    known, local = spools or {}, local or {}
    return tuple(
        NodeStatus(
            **asdict(_with_disk(member.report, known.get(member.name))),
            **asdict((health or {}).get(member.name, CameraHealth())),
            disk_free_bytes=space.free_bytes if (space := known.get(member.name)) else None,
            on_leader=member.name in local,
            spec=local.get(member.name, ""),
            name=member.name,
            address=str(Address(*member.address)),
            camera=member.camera,
            parent=member.via,
            depth=1 + max(len([*relays_above(member, by_name)]), member.via is not None),
            last_seen_ns=now_ns - member.last_heard_ns,
        )
        for member in members
    )


def fitted(make: Callable[[int], RigStatus]) -> RigStatus:
    """Return `make(n)` with as many nodes as a page has and a message can carry."""
    nodes = MAX_PER_PAGE
    while len(msgspec.json.encode(status := make(nodes))) > MAX_STATUS_BYTES and nodes > 1:
        nodes //= 2
    return status


def fitted_burst(burst: BurstStatus) -> BurstStatus:
    """Return the status of a burst without the parts that are too long for a message; its text says so."""
    burst = replace(burst, message=cut(burst.message, MAX_BURST_TEXT))
    if len(msgspec.json.encode(burst)) <= MAX_BURST_BYTES:
        return burst
    text = "; ".join(filter(None, (burst.message, "the progress of each camera is too long to be listed")))
    return replace(burst, message=text, transfer=(), skipped=())


def page_of(members: tuple[Member, ...], after: str, max_nodes: int) -> tuple[tuple[Member, ...], int, str]:
    """Return a page of nodes after the name `after`, the number of further nodes, and a summary of those."""
    rest = members[bisect_right(members, after, key=lambda member: member.name) :] if after else members
    page, further = rest[:max_nodes], rest[max_nodes:]
    words = ", ".join(
        f"{number} {state}"
        for state, number in sorted(Counter(str(camera.report.state) for camera in further).items())
    )
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
