"""`reconstruct batch`."""

from pathlib import Path

import click

from capture_app.errors import ExitCode, SimulshotError
from capture_app.terminal import json_option, print_json, print_line, talk
from reconstruction.commands.options import CONDITION_HELP, ConditionType, out_option
from reconstruction.session.conditions import SYNCED, Condition

MAX_INSTANTS = 100_000


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
                if not 0 < len(span) <= MAX_INSTANTS:
                    raise ValueError
                found += span
        except ValueError:
            self.fail(f"{value!r} is not a list of instants, as in 0,4-8", param, ctx)
        return tuple(dict.fromkeys(found))


@click.command()
@click.argument("sessions", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--condition",
    "conditions",
    type=ConditionType(),
    multiple=True,
    default=(SYNCED,),
    help=f"{CONDITION_HELP} Repeat for several.",
)
@click.option("--instants", type=_Instants(), show_default="all", help="Instants to process, as in 0,4-8.")
@click.option(
    "--matcher",
    type=click.Choice(["sweep", "patchmatch"]),
    default="sweep",
    help="sweep runs on the CPU; patchmatch is COLMAP's and needs an NVIDIA GPU.",
)
@click.option(
    "--executor",
    type=click.Choice(["local", "slurm"]),
    default="local",
    help="local starts processes on this machine, slurm submits jobs to its cluster.",
)
@click.option(
    "--slurm",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="SLURM setting, as in partition=gpu, time=30 (minutes), mem=8GB, cpus_per_task=4. "
    "Repeat for several.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    show_default="one per core, as memory allows; with SLURM no limit",
    help="Number of instants to process in parallel.",
)
@out_option
@json_option
def batch(
    sessions: tuple[Path, ...],
    conditions: tuple[Condition, ...],
    instants: tuple[int, ...] | None,
    matcher: str,
    executor: str,
    settings: tuple[str, ...],
    jobs: int | None,
    out: Path,
    as_json: bool,
) -> None:
    """Compute depth maps and point clouds of many instants of SESSIONS, in one or more conditions.

    Results already in --out are reused: repeat the command after an interruption, or with more sessions,
    instants or conditions.
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
        print_line(f"{result.computed} computed, {result.reused} reused, {result.failed} failed")
        print_line(f"summary: {out / 'summary.html'}")
    code = exit_code(result)
    if code is not ExitCode.OK:
        failure = SimulshotError(
            f"{result.failed} of {len(result.units)} failed", hint="repeat the command to retry"
        )
        failure.exit_code = code
        raise failure
