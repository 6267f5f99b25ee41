"""`capture-app leader`: synchronize nodes, take bursts on request, save sessions."""

import asyncio
import contextlib
import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from capture_app.commands.leader_choice import inviting_phones, joining_command
from capture_app.commands.shared_options import (
    ADDRESS,
    ANY_PATH,
    FOLLOWERS,
    PHONES,
    host_option,
    open_option,
    plugin_options,
    port_option,
    run_until_stopped,
    sessions_option,
    spool_option,
    stagger_option,
)
from capture_app.common import system
from capture_app.common.address import LOOPBACK_HOSTS, Address
from capture_app.common.pairing_codes import Role, show_code
from capture_app.common.plugins import COMMANDS, plugin_names
from capture_app.common.stagger import Stagger
from capture_app.common.tasks import first_of, has_come
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import FiniteRange, json_option, log_line, print_json_line, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.node.leader.leader_node import LeaderNode


@click.command(
    cls=RuledCommand,
    rules=(Rule("--camera", "!--leader", ": run the camera with capture-app node and all --leader"),),
    epilog=examples(
        "capture-app leader", "capture-app leader --camera v4l2:/dev/video0 --sessions ~/sessions"
    ),
)
@host_option
@port_option
@click.option(
    "--leader",
    "leaders",
    type=ADDRESS,
    multiple=True,
    metavar="HOST:PORT",
    help="Address of a leader, this one included; the first one alive leads. Repeat, preferred first.",
)
@sessions_option
@click.option(
    "--fps",
    type=FiniteRange(0.1, 1000.0),
    metavar="FPS",
    show_default="the rate of most cameras",
    help="Frame rate of all cameras.",
)
@click.option(
    "--camera",
    "cameras",
    multiple=True,
    metavar="SPEC",
    help="Also run a camera of this machine. Repeatable.",
)
@click.option(
    "--align-row",
    type=FiniteRange(0.0, 1.0),
    metavar="FRACTION",
    show_default="the start of the first row",
    help="Align frames at mid-exposure of this row, a fraction of the image height from the top.",
)
@stagger_option
@plugin_options(FOLLOWERS)
@click.option(
    "--phones",
    "with_phones",
    is_flag=True,
    hidden=PHONES not in plugin_names(COMMANDS),
    help="Also accept phones as cameras: shows a QR code for each in turn.",
)
@spool_option
@open_option
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin closes: the parent is gone.")
@click.option("--until-unused", is_flag=True, hidden=True, help="Stop when it has no camera and no operator.")
@click.option("--log", type=ANY_PATH, hidden=True, help="The file that stderr is: a rig in the background.")
@json_option
def leader(
    host: str,
    port: int,
    leaders: tuple[Address, ...],
    sessions: Path,
    fps: float | None,
    align_row: float | None,
    stagger: Stagger | None,
    with_phones: bool,
    cameras: tuple[str, ...],
    spool: Path,
    until_eof: bool,
    until_unused: bool,
    log: Path | None,
    as_json: bool,
    **of_followers: Any,
) -> None:
    """Run a leader until Ctrl-C: nodes join it, and `capture-app burst` takes bursts with it.

    Events are logged on stderr, and with --json also on stdout, one JSON object a line.
    """
    from capture_app.node.followers import make_followers
    from capture_app.node.leader.leader_options import LeaderOptions
    from capture_app.node.leader.standby import lead_by_rank
    from capture_app.protocol.log import Log

    source = click.get_current_context().get_parameter_source("port")
    or_free_port = log is not None and source is ParameterSource.DEFAULT
    events = Log(log_line, record=_print_event if as_json else None)

    def make_options() -> LeaderOptions:
        return LeaderOptions(
            host=host,
            port=port,
            or_free_port=or_free_port,
            sessions=sessions,
            period_ns=None if fps is None else round(1e9 / fps),
            align_row=align_row,
            stagger=stagger,
            followers=make_followers(of_followers),
            log=events,
            spool=spool,
        )

    run = functools.partial(
        _run_leader,
        among=leaders,
        cameras=cameras,
        with_phones=with_phones,
        until_unused=until_unused,
        log=log,
        as_json=as_json,
    )
    system.raise_thread_priority()
    system.reuse_freed_memory()
    run_until_stopped(lead_by_rank(make_options, leaders, run), until_eof=until_eof)


def _print_event(event: dict[str, object]) -> None:
    """Print an event for another program; the rig goes on without it."""
    with contextlib.suppress(OSError):
        print_json_line(event)


async def _run_leader(
    node: "LeaderNode",
    among: tuple[Address, ...],
    cameras: tuple[str, ...],
    with_phones: bool,
    until_unused: bool,
    log: Path | None,
    as_json: bool,
) -> None:
    from capture_app.machine.doctor import warnings_for_leader
    from capture_app.protocol.orders import AddCamera, InvitePhone, PhoneInvited
    from capture_app.rig.process import recorded_rig
    from capture_app.rig.rig_link import ask_leader

    host, sessions = node.options.host, node.options.sessions
    with contextlib.ExitStack() as record:
        async with node.announced(among=among):
            talk(f"leader at {node.address}, sessions in {sessions}")
            talk(f"join with: capture-app node --leader {node.address} --camera SPEC")
            _offer_codes(node, host, on_terminal=log is None and sys.stdin.isatty())
            for warning in await asyncio.to_thread(warnings_for_leader, host, node.address.port, sessions):
                talk(warning)
                node.log.add(warning, level="warning")
            if as_json:
                print_json_line(
                    {
                        "event": "listening",
                        "leader": str(node.address),
                        "port": node.address.port,
                        "sessions": str(sessions),
                    }
                )
            for spec in cameras:
                await node.service.carry_out(AddCamera(spec=spec))
            record.enter_context(recorded_rig(node.own_address, sessions, log))
            async with contextlib.AsyncExitStack() as phones:
                if with_phones:
                    ask = functools.partial(ask_leader, node.own_address, InvitePhone(), PhoneInvited)
                    await phones.enter_async_context(inviting_phones(ask, as_json))
                stop = node.service.stop_requested
                if until_unused:
                    await first_of(has_come(stop, None), node.wait_until_unused())
                else:
                    await stop.wait()
            log_line("stopped by an operator" if stop.is_set() else "stopped: no camera and no operator came")


def _offer_codes(node: "LeaderNode", host: str, *, on_terminal: bool) -> None:
    """Print how to pair other machines; at a terminal, Enter shows a pairing code for the next one."""
    if node.options.trust.is_open:
        talk("OPEN: anyone who reaches this port can see and control everything (--open)")
    elif host not in LOOPBACK_HOSTS:
        shows = "Enter shows one here" if on_terminal else "capture-app trust invite shows one"
        talk(f"an unpaired machine needs a pairing code once: {shows}")
        if on_terminal:
            system.watch_input(functools.partial(_show_code, node))


def _show_code(node: "LeaderNode", typed: bytes) -> None:
    if not typed:
        return
    invited = node.enrolment.invite(Role.CAMERA)
    talk(
        f"code {show_code(invited.code)} pairs one machine within {invited.good_for_s // 60} min; type there:"
    )
    talk(f"  {joining_command(str(node.address), Role.CAMERA, invited.code)}")
