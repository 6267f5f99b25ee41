"""What an engine knows of its clients as the status that people and programs see: a tree of nodes."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence

from msgspec.structs import asdict, replace

from capture_app.net.address import Address
from capture_app.node.wire.messages import SpoolSpace
from capture_app.node.wire.operating import Vitals
from capture_app.node.wire.status import NodeStatus
from capture_app.sync.rig.roster import ClientView
from capture_app.sync.wire.messages import MAX_DEPTH, WITHOUT_CAMERA, NodeState, Report
from capture_app.text import count

MOST_OF_A_PAGE = 250


def node_statuses(
    views: tuple[ClientView, ...],
    all_views: tuple[ClientView, ...] | None = None,
    *,
    vitals: Mapping[str, Vitals] | None = None,
    spools: Mapping[str, SpoolSpace] | None = None,
    local: Collection[str] = (),
) -> tuple[NodeStatus, ...]:
    """These nodes by name, with their place in the tree of all; `local` are processes of the leader's."""
    by_name = {view.name: view for view in all_views or views}
    known = spools or {}
    return tuple(
        NodeStatus(
            **asdict(_with_disk(view.report, known.get(view.name))),
            **asdict((vitals or {}).get(view.name, Vitals())),
            disk_free_bytes=space.free_bytes if (space := known.get(view.name)) else None,
            on_leader=view.name in local,
            name=view.name,
            address=str(Address(*view.address)),
            camera=view.camera,
            parent=view.via,
            depth=_depth(view, by_name),
            last_seen_ns=view.age_ns,
        )
        for view in views
    )


def page_of(views: tuple[ClientView, ...], after: str | None) -> tuple[tuple[ClientView, ...], int, str]:
    """Return the nodes of a page, which are after that name, how many follow it, and what those are in words.

    None for all of them. A page is short enough for a message.
    """
    if after is None:
        return views, 0, ""
    rest = views[bisect_right(views, after, key=lambda view: view.name) :] if after else views
    page, further = rest[:MOST_OF_A_PAGE], rest[MOST_OF_A_PAGE:]
    states = Counter(str(view.report.state) for view in further)
    words = ", ".join(f"{number} {state}" for state, number in sorted(states.items()))
    text = f"and {count(len(further), 'more node')}, not listed here: {words}" if further else ""
    return page, len(further), text


def _with_disk(report: Report, space: SpoolSpace | None) -> Report:
    """A node's report, with what is wrong with its disk where it has nothing else to say."""
    if space is None or not space.problem or report.message or report.state is NodeState.LOST:
        return report
    return replace(report, message=space.problem)


def in_tree_order(nodes: tuple[NodeStatus, ...]) -> Iterator[NodeStatus]:
    """Yield nodes in the order of a tree: each relay, then what is below it; every node once."""
    names = {node.name for node in nodes}
    below: dict[str | None, list[NodeStatus]] = {}
    for node in nodes:
        # Cameras may be left of a relay that is not known any more.
        below.setdefault(node.parent if node.parent in names else None, []).append(node)
    shown: set[str] = set()
    stack = below.get(None, [])[::-1]
    while stack:
        node = stack.pop()
        shown.add(node.name)
        yield node
        stack += [child for child in below.get(node.name, [])[::-1] if child.name not in shown]
    yield from (node for node in nodes if node.name not in shown)


def present_cameras(views: Sequence[ClientView]) -> list[ClientView]:
    """The nodes that are not lost and can take pictures."""
    return [
        view
        for view in views
        if view.report.state is not NodeState.LOST and view.camera.kind not in WITHOUT_CAMERA
    ]


def _depth(view: ClientView, by_name: Mapping[str, ClientView]) -> int:
    depth, at = 1, view
    while at.via is not None and depth <= MAX_DEPTH:
        depth += 1
        if at.via not in by_name:
            break
        at = by_name[at.via]
    return depth
