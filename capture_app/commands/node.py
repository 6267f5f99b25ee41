"""`capture-app node`: one camera, synchronized with the others of its leader."""

import functools
import socket
from pathlib import Path
from zlib import crc32

import click
from click.core import ParameterSource

from capture_app.commands.leader_choice import leaders_to_join, pairing_options
from capture_app.commands.shared_options import (
    clock_option,
    confirm,
    leaders_option,
    name_option,
    open_option,
    run_until_stopped,
    spool_option,
)
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.bounds import MAX_TEXT
from capture_app.common.clock import parse_clock
from capture_app.common.errors import BadInputError
from capture_app.common.names import check_label, folder_names, label_key, name_like
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import FiniteRange, log_line, print_line, talk
from capture_app.console.usage import examples


@click.command(
    cls=RuledCommand,
    rules=(Rule("--yes", "--at-boot"),),
    epilog=examples(
        "capture-app node --camera v4l2:/dev/video0",
        "capture-app node --camera webcam:0",
        "capture-app node --camera v4l2:/dev/video0 --camera v4l2:/dev/video2",
        "capture-app node --camera v4l2:/dev/video0,sound=own",
        "capture-app node --camera v4l2:/dev/video2 --name left --leader 192.168.1.20",
        "capture-app node --camera v4l2:/dev/video0 --leader 192.168.1.20 --at-boot",
    ),
)
@name_option("Name of this node and its camera; several are named NAME-DEVICE.", check_label)
@click.option(
    "--camera",
    "specs",
    multiple=True,
    required=True,
    metavar="SPEC",
    help="The camera, as listed by `capture-app cameras`. Repeatable.",
)
@leaders_option
@clock_option
@click.option(
    "--tolerance-us",
    type=FiniteRange(1.0, 100_000.0),
    metavar="US",
    show_default="100; 2000 for a camera that can only restart its stream",
    help="Phase errors up to this are left alone.",
)
@click.option(
    "--clock-tolerance-us",
    type=FiniteRange(1.0, 100_000.0),
    metavar="US",
    show_default="what the link can bear: 15 % of its round trip, at least --tolerance-us, at most 1000",
    help="Clock accuracy that is required to be ready. Frames are aligned the same with any value.",
)
@spool_option
@click.option(
    "--ring-mb",
    type=FiniteRange(1.0, 1_000_000.0),
    show_default="256",
    metavar="MB",
    help="Memory limit of the ring buffer, and again of frames not yet on disk.",
)
@click.option(
    "--hold-phase",
    is_flag=True,
    help="Keep the camera in phase in recordings, by longer frames: an instant may have no frame then.",
)
@click.option(
    "--at-boot/--not-at-boot",
    default=None,
    show_default=False,
    help="Install a systemd service that runs this node at each boot, after asking; or remove it.",
)
@click.option("--yes", is_flag=True, help="With --at-boot: install without asking.")
@pairing_options
@open_option
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin closes: the parent is gone.")
def node(
    name: str,
    specs: tuple[str, ...],
    leaders: tuple[Address, ...],
    clock_text: str,
    tolerance_us: float | None,
    clock_tolerance_us: float | None,
    spool: Path,
    ring_mb: float | None,
    hold_phase: bool,
    at_boot: bool | None,
    yes: bool,
    pin: str | None,
    code: str | None,
    until_eof: bool,
) -> None:
    """Run a camera until Ctrl-C. The node waits for a leader that is not running, and rejoins it.

    Several cameras run in one process with one clock; a missing camera is waited for while the others run.
    Without --leader the node searches the local network, and asks if there are several leaders. A relay's
    address works like a leader's. An unpaired machine is paired once, by --code or by the code asked for.
    """
    from capture_app.node.camera.node_group import camera_node, name_cameras, run_nodes
    from capture_app.node.camera.spool import free_spool

    if len(name.encode()) > MAX_TEXT:
        raise BadInputError(f"--name has over {MAX_TEXT} bytes", hint="give this node a shorter one")
    folder = _folder_of(name, specs, spool)
    named = name_cameras(folder, specs)
    if at_boot is not None:
        _arrange_boot(folder, name, at_boot, yes)
        return
    clock = parse_clock(clock_text, node=folder)
    leaders = leaders_to_join(leaders, pin, code, next(iter(named)))
    from capture_app.protocol.log import Log

    ring = {} if ring_mb is None else {"ring_bytes": round(ring_mb * 1e6)}
    titles = {camera: camera.replace(folder, name, 1) for camera in named}
    nodes = {
        camera: camera_node(
            camera,
            spec,
            label=titles[camera] if name != folder else "",
            leaders=leaders,
            clock=clock,
            tolerance_ns=None if tolerance_us is None else round(tolerance_us * 1000),
            clock_tolerance_ns=None if clock_tolerance_us is None else round(clock_tolerance_us * 1000),
            spool=free_spool(spool, camera) if until_eof else spool,
            log=Log(functools.partial(_log_line_of, titles[camera]), name=camera),
            moves_in_recordings=hold_phase,
            **ring,
        )
        for camera, spec in named.items()
    }
    system.raise_thread_priority()
    system.reuse_freed_memory()
    run_until_stopped(run_nodes(nodes, Log(log_line)), until_eof=until_eof)


def _folder_of(name: str, specs: tuple[str, ...], spool: Path) -> str:
    """Return the name of a node's folders: its own, or what is nearest to it.

    Names without a letter of ASCII differ by the machines' names, and those of one machine by a checksum; a
    spool that has none of it is gone on with.
    """
    from capture_app.node.camera.node_group import name_cameras

    own = name_like(socket.gethostname(), "node")
    if not any((spool / camera).is_dir() for camera in name_cameras(f"{own}0", specs)):
        own += f"-{crc32(label_key(name).encode()) % 10_000:04}-"
    return folder_names([name], "node", own)[0]


def _log_line_of(name: str, line: str) -> None:
    log_line(f"{name}: {line}")


def _arrange_boot(name: str, label: str, at_boot: bool, yes: bool) -> None:
    from capture_app.machine.boot_service import BootService

    service = BootService(name, ("node", "--name", label, *_typed_options("name", "at_boot", "yes")))
    if not at_boot:
        service.remove()
        talk(f"{name} no longer starts with this machine")
        return
    print_line(f"# {service.path}\n{service.text()}")
    if not yes:
        question = "Write this file, and start the node now and whenever the machine starts?"
        confirm(question, "the service is not installed: there is no terminal to ask at")
    left_to_do = service.install()
    talk(f"{name} is running, and starts with this machine; its log: {service.log_command}")
    if left_to_do:
        talk(left_to_do)


def _typed_options(*but: str) -> list[str]:
    """Return the options of the running command that were typed, in full, paths made absolute."""
    context, words = click.get_current_context(), []
    for option in context.command.params:
        name = option.name or ""
        if name in but or context.get_parameter_source(name) is not ParameterSource.COMMANDLINE:
            continue
        value = context.params.get(name, True)  # a flag with an effect of its own, such as --open
        for part in value if isinstance(value, tuple) else (value,):
            words.append(option.secondary_opts[0] if part is False else option.opts[0])
            if not isinstance(part, bool):
                words.append(str(part.absolute() if isinstance(part, Path) else part))
    return words
