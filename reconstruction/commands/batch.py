"""`reconstruct batch`."""

import sys
from pathlib import Path

import click

from capture_app.errors import ExitCode
from capture_app.terminal import json_option, print_json, print_line, talk

MOST_INSTANTS = 100_000


class _Instants(click.ParamType[tuple[int, ...]]):
    """Numbers of instants and ranges of them, with commas between."""

    name = "K,K-L,..."

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """Split the text."""
        found: list[int] = []
        try:
            for part in str(value).split(","):
                first, _, last = part.partition("-")
                span = range(int(first), int(last or first) + 1)
                if not 0 < len(span) <= MOST_INSTANTS:
                    raise ValueError
                found += span
        except ValueError:
            self.fail(f"{value!r} is not instants, as in 0,4-8", param, ctx)
        return tuple(dict.fromkeys(found))


@click.command()
@click.argument("sessions", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--condition",
    "conditions",
    multiple=True,
    default=("synced",),
    show_default=True,
    help="synced; distinct: each camera off by another of -66,-33,0,33,66 ms; MS: every second camera so "
    "much later; MS,MS,... or CAMERA=MS,...: how much later each is. May be given several times.",
)
@click.option("--instants", type=_Instants(), help="Instants, as in 0,4-8 [default: all].")
@click.option(
    "--matcher",
    type=click.Choice(["sweep", "patchmatch"]),
    default="sweep",
    show_default=True,
    help="sweep: on the CPU. patchmatch: COLMAP's, on an NVIDIA GPU.",
)
@click.option(
    "--executor",
    type=click.Choice(["local", "slurm"]),
    default="local",
    show_default=True,
    help="local: processes of this machine. slurm: jobs of the cluster that this machine belongs to.",
)
@click.option(
    "--slurm",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting for SLURM, as in partition=gpu, time=30 (minutes), mem=8GB, cpus_per_task=4.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Units at a time [default: one per core, if memory allows; slurm: what the cluster takes].",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the results.")
@json_option
def batch(
    sessions: tuple[Path, ...],
    conditions: tuple[str, ...],
    instants: tuple[int, ...] | None,
    matcher: str,
    executor: str,
    settings: tuple[str, ...],
    jobs: int | None,
    out: Path,
    as_json: bool,
) -> None:
    """Make the depth and the cloud of many instants of SESSIONS, in one condition or several.

    What is in the --out folder already is not made again: after an interruption, or with more sessions,
    instants or conditions, repeat the command.
    """

    from reconstruction.batch.command import BatchOptions, exit_code
    from reconstruction.batch.command import batch as run
    from reconstruction.batch.executors import Executor, LocalExecutor

    chosen: Executor
    if executor == "slurm":
        from reconstruction.batch.slurm import SlurmExecutor

        chosen = SlurmExecutor(jobs, settings)
    elif settings:
        raise click.UsageError("--slurm is for --executor slurm")
    else:
        chosen = LocalExecutor(jobs)
    options = BatchOptions(conditions=conditions, instants=instants, matcher=matcher)
    result = run(sessions, out, options, chosen, talk)
    if as_json:
        print_json(result)
    else:
        print_line(f"{result.made} made, {result.there} there already, {result.failed} failed")
        print_line(f"summary: {out / 'summary.html'}")
    code = exit_code(result)
    if code is not ExitCode.OK:
        count = f"{result.failed} of {len(result.units)} failed"
        talk(f"reconstruct: error: {count}; repeat the command to try these again")
        sys.exit(int(code))
