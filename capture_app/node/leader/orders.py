"""What operators ask a leader to do beside taking bursts: to add and remove cameras, to cancel, to end."""

import asyncio

from capture_app.errors import BadInputError, NotAvailableError
from capture_app.net.udp import Pump
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.wire import operating
from capture_app.sync.rig.leader import Leader

FORGET_CHECKS, FORGET_CHECK_S = 60, 0.05


class OperatorOrders:
    """Carries them out, for one leader."""

    def __init__(self, engine: Leader, bursts: ActiveBursts, local: LocalNodes | None, pump: Pump) -> None:
        """`local` starts nodes on this machine; None where this leader does not."""
        self.stop_wanted = asyncio.Event()
        """Set when an operator wants this leader to end."""
        self._engine, self._bursts, self._local, self._pump = engine, bursts, local, pump
        self._options = bursts.options
        self._own_pin = "" if self._options.trust.is_open else self._options.trust.identity.pin

    async def carry_out(self, order: operating.Order) -> operating.Done | operating.PhoneInvited:
        """Do what is asked, and return when it is done. Raises the errors of what is asked."""
        names: tuple[str, ...] = ()
        match order:
            case operating.AddCamera(spec=spec, name=name):
                names = (await self._nodes().add_camera(spec, name, self._taken()),)
            case operating.AddSimulated(cameras=cameras, scene=scene):
                names = await self._nodes().add_simulated(cameras, scene, taken=self._taken())
            case operating.RemoveCamera(name=name):
                await self._remove(name)
            case operating.CancelBurst(burst=burst):
                await self._bursts.cancel(burst)
            case operating.EndBurst(burst=number):
                await self._bursts.end(number)
                self._pump.turn()
            case operating.ExposeAppPhones(exposure_ns=exposure_ns, iso=iso):
                for follower in self._options.followers:
                    follower.expose(exposure_ns, iso)
            case operating.InvitePhone():
                return await self._nodes().phones.invitation()
            case operating.StopRig():
                self._options.news.add("stopped by an operator")
                self.stop_wanted.set()
        return operating.Done(names=names)

    def _nodes(self) -> LocalNodes:
        if self._local is None:
            raise NotAvailableError(
                "this leader runs no cameras", hint="start them with capture-app node on their machine"
            )
        return self._local

    def _taken(self) -> list[str]:
        """Names of nodes that are here, and of other machines; a lost one may come back under its name."""
        here = [name for name in self._engine.members if self._is_here(name)]
        return here + [name for name, pin in self._engine.owners.items() if pin != self._own_pin]

    def _is_here(self, name: str) -> bool:
        member = self._engine.members.get(name)
        return member is not None and not member.lost

    async def _remove(self, name: str) -> None:
        if self._local is not None and name in self._local.names:
            await self._local.remove(name)
            # It says goodbye as it ends; one that had to be killed is noticed by its silence.
            for _ in range(FORGET_CHECKS):
                if not self._is_here(name):
                    break
                await asyncio.sleep(FORGET_CHECK_S)
            if name not in self._engine.members:
                return
        if self._is_here(name):
            raise BadInputError(
                f"{name} runs on {self._engine.members[name].address[0]}, not as a process of the leader's",
                hint="stop its capture-app node there",
            )
        self._engine.forget(name)
        self._pump.turn()
