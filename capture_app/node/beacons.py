"""A leader's or a relay's beacons on their way out: to all networks that its own nodes are on."""

from capture_app.net.multicast import BEACONS, BeaconSender
from capture_app.sync.beacon import Group
from capture_app.sync.leader import Leader
from capture_app.sync.state import NodeState


class Beacons:
    """Sends what an engine has for its group, if beacons are asked for."""

    def __init__(self, *, wanted: bool) -> None:
        self.group: Group | None = BEACONS if wanted else None
        self._sender: BeaconSender | None = None

    def send_due(self, engine: Leader, now_ns: int) -> None:
        """Send the beacon that is due, if any; `now_ns` is the engine's time."""
        beacon = engine.beacon_to_send()
        if beacon is None or self.group is None:
            return
        if self._sender is None:
            self._sender = BeaconSender(self.group)
        own = [view for view in engine.clients(now_ns) if view.via is None]
        self._sender.reach(view.address[0] for view in own if view.report.state is not NodeState.LOST)
        self._sender.send(beacon)

    def close(self) -> None:
        """Send no more. Calling it twice is harmless."""
        if self._sender is not None:
            self._sender.close()
