"""`capture-app demo`: from simulated cameras to a comparison."""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import FOLDER, run_until_stopped
from capture_app.common.text import ProgressStep
from capture_app.console.terminal import answer, json_option, show_progress, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.commands.demo_run import DemoResult


@click.command(epilog=examples("capture-app demo", "capture-app demo --cameras 3 --out /tmp/demo"))
@click.option("--cameras", type=click.IntRange(2, 7), default=5, metavar="N", help="Simulated cameras.")
@click.option(
    "--out",
    type=FOLDER,
    default=Path("demo"),
    metavar="DIR",
    help="Folder for the session and the comparison.",
)
@json_option
def demo(cameras: int, out: Path, as_json: bool) -> None:
    """Synchronize simulated cameras, take a burst, and compare synchronized with delayed pictures.

    Each camera is a process whose clock is hours off; they communicate over this machine's network.
    """
    from capture_app.commands.demo_run import run_demo

    result = run_until_stopped(run_demo(out, cameras, _show_line))
    answer(as_json, result, _lines(result), said=f"done in {result.seconds:.0f} s")


def _show_line(line: str) -> None:
    step = ProgressStep.parse(line)
    if step is None:
        talk(line)
    else:
        show_progress(step)


def _lines(result: "DemoResult") -> Iterator[str]:
    head = ("camera", "clock error µs", "phase error µs", "total error µs", "hard bound µs")
    rows = []
    for node in result.sync.nodes:
        times_ns = (node.clock_error_ns, node.phase_error_ns, node.total_error_ns, node.hard_bound_ns)
        rows.append((node.name, *(f"{time_ns / 1000:.1f}" for time_ns in times_ns)))
    yield table(head, rows)
    yield "\n" + textwrap.fill(str(result.compare.get("verdict", "")), 88) + "\n"
    yield f"session  {result.session}"
    yield f"report   {result.report}"
