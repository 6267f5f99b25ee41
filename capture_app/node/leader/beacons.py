"""The beacons of a leader or a relay, sent where its nodes are."""

from collections.abc import Callable

from capture_app.net.multicast import BeaconSender
from capture_app.sync.rig.leader import Leader
from capture_app.sync.wire.messages import NodeState


def send_due_beacon(
    sender: BeaconSender | None,
    engine: Leader,
    now_ns: int,
    seal: Callable[[bytes], bytes] | None = None,
) -> None:
    """Send the beacon that is due, if any, to where an engine's own nodes are, at `now_ns` of its time.

    `seal` returns the datagram of a message to all; None in a rig without seals.
    """
    beacon = engine.beacon_to_send()
    if beacon is None or sender is None:
        return
    own = [view for view in engine.clients(now_ns) if view.via is None]
    sender.set_destinations(view.address[0] for view in own if view.report.state is not NodeState.LOST)
    sender.send(beacon if seal is None else seal(beacon))
