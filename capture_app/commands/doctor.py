"""`capture-app doctor`: check this machine, and report repairs for the problems found."""

import asyncio
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from capture_app.commands.shared_options import ADDRESS, ANY_PATH, spool_option
from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.common.plugins import CAMERA_COMMANDS, COMMANDS, plugin_names
from capture_app.common.text import UNREADABLE, count, pretty_json
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import answer, json_option, talk
from capture_app.console.usage import examples
from capture_app.session.files.durable import write_atomic

if TYPE_CHECKING:
    from capture_app.machine.doctor import Finding


@click.command(
    cls=RuledCommand,
    rules=(Rule("--camera --panel", "--report"),),
    epilog=examples(
        "capture-app doctor",
        "capture-app doctor --leader 192.168.1.20",
        "capture-app doctor --report report.json",
    ),
)
@click.option(
    "--leader",
    "leaders",
    type=ADDRESS,
    multiple=True,
    metavar="HOST:PORT",
    help="Leader or relay that this machine has to reach. Repeatable.",
)
@click.option(
    "--report",
    type=ANY_PATH,
    metavar="FILE",
    help="Also write all findings to FILE as JSON, for a hardware report.",
)
@click.option(
    "--camera",
    "specs",
    multiple=True,
    metavar="SPEC",
    hidden="characterize" not in plugin_names(CAMERA_COMMANDS),
    help="With --report: add the measurements of `cameras characterize` of SPEC. Repeatable.",
)
@click.option(
    "--panel",
    type=ANY_PATH,
    metavar="SESSION",
    hidden="panel" not in plugin_names(COMMANDS),
    help="With --report: add the measurements of `panel read` of SESSION.",
)
@spool_option
@json_option
def doctor(
    leaders: tuple[Address, ...],
    spool: Path,
    report: Path | None,
    specs: tuple[str, ...],
    panel: Path | None,
    as_json: bool,
) -> None:
    """Check this machine for problems that prevent it from leading or joining a rig, and show remedies.

    Run it on the leader's machine or on a camera's. It checks versions, the connection to the leader,
    pairing, firewalls, WiFi, the clock, disks, USB and permissions, and changes nothing. With problems, the
    exit code is 1.
    """
    from capture_app.machine.doctor import examine
    from capture_app.rig.process import list_rigs

    rigs = [(rig.address, Path(rig.sessions)) for rig in list_rigs()]
    if not as_json:
        talk("checking this machine …")
    checks = asyncio.run(examine(leaders, rigs, spool))
    problems = [finding for finding in checks if finding.grade == "problem"]
    if report is not None:
        measured = {spec: _ask("cameras", "characterize", spec) for spec in specs}
        read = None if panel is None else _ask("panel", "read", str(panel))
        write_atomic(
            report, pretty_json({"doctor": checks, "cameras": measured, "panel": read}), synced=False
        )
    answer(as_json, {"findings": checks, "problems": len(problems)}, _lines(checks))
    if problems:
        raise SimulshotError(
            f"{count(len(problems), 'problem')} found", hint="each remedy is below its problem"
        )


def _ask(*command: str) -> Any:
    """Return another command's JSON output, or its error."""
    talk(f"{' '.join(command)} …")
    arguments = (sys.executable, "-m", "capture_app.cli", *command, "--json", "--quiet")
    done = subprocess.run(arguments, capture_output=True, check=False)  # noqa: S603 - our own program
    try:
        return msgspec.json.decode(done.stdout)
    except UNREADABLE:
        return {"error": done.stderr.decode(errors="replace").strip()}


def _lines(findings: "Sequence[Finding]") -> Iterator[str]:
    for finding in findings:
        yield f"{finding.grade:7}  {finding.check:9}  {finding.text}"
        if finding.remedy:
            yield f"{'':20}→ {finding.remedy}"
