"""`reconstruct batch`."""

from pathlib import Path
from typing import Any

import click

from capture_app.common.errors import ExitCode, SimulshotError
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import SESSION, answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import (
    CONDITION,
    CONDITION_HELP,
    matcher_option,
    out_option,
    parse_instants,
    time_shift_option,
)
from reconstruction.scene.conditions import SYNCED


@click.command(
    cls=RuledCommand,
    rules=(
        Rule("--shard --jobs --cluster --cluster-setting", "!--summary", ": it is of all that was computed"),
    ),
    epilog=examples(
        "reconstruct batch sessions/burst-001 sessions/burst-002 --out depth",
        "reconstruct batch sessions/burst-001 --condition synced --condition 66 --instants 0-4 --out depth",
        "reconstruct batch sessions/* --shard $SLURM_ARRAY_TASK_ID/8 --out depth",
        "reconstruct batch sessions/* --summary --out depth",
        "reconstruct batch sessions/* --splats --out depth",
    ),
)
@click.argument("sessions", type=SESSION, nargs=-1, required=True)
@click.option(
    "--condition",
    "conditions",
    type=CONDITION,
    metavar="CONDITION",
    multiple=True,
    default=(SYNCED,),
    help=f"{CONDITION_HELP} Repeat for several.",
)
@click.option(
    "--instants",
    type=parse_instants,
    metavar="K,K-L,...",
    show_default="all",
    help="Instants to process, as in 0,4-8.",
)
@matcher_option
@time_shift_option
@click.option(
    "--cluster",
    metavar="WHERE",
    default="local",
    help="Where to compute: local (processes of this machine), a queueing system (slurm, pbs, lsf, sge, oar, "
    "moab, htcondor), or the address of a Dask scheduler, as in tcp://host:8786.",
)
@click.option(
    "--cluster-setting",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Setting of a queue's jobs, as in queue=gpu, walltime=02:00:00, memory=8GB, cores=4. "
    "Repeat for several.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    show_default="one per core, as memory allows; in a queue one per instant, at most 100",
    help="Number of instants to process in parallel.",
)
@click.option(
    "--shard",
    metavar="I/N",
    help="Process only the I-th of N parts, and write no summary. The parts may run at the same time, as "
    "jobs of an array.",
)
@click.option(
    "--summary",
    is_flag=True,
    help="Process nothing, and write the summary of what is there. Use it when all shards have ended.",
)
@click.option(
    "--splats",
    is_flag=True,
    help="Also make a Gaussian splat of each instant.",
)
@out_option
@json_option
def batch(
    sessions: tuple[Path, ...],
    cluster: str,
    settings: tuple[str, ...],
    jobs: int | None,
    shard: str | None,
    summary: bool,
    out: Path,
    as_json: bool,
    **options: Any,
) -> None:
    """Compute depth maps and point clouds of many instants of SESSIONS, in one or more conditions.

    Results already in --out are reused: repeat the command after an interruption, or with more sessions,
    instants or conditions.
    """
    from reconstruction.common.templates import render_lines
    from reconstruction.methods.batch.batch_plan import BatchPlan
    from reconstruction.methods.batch.batch_run import batch as run
    from reconstruction.methods.batch.batch_run import exit_code, summarize
    from reconstruction.methods.batch.units import Shard
    from reconstruction.methods.batch.workers import Workers

    chosen, part = BatchPlan(**options), Shard.parse(shard) if shard else None
    result = (
        summarize(sessions, out, chosen)
        if summary
        else run(sessions, out, chosen, Workers(cluster, jobs, settings), shard=part)
    )
    lines = render_lines("batch.txt", __package__, result=result, out=out, part=part)
    answer(as_json, result, lines)
    if (code := exit_code(result)) is not ExitCode.OK:
        failure = SimulshotError(
            f"{result.failed} of {len(result.units)} failed",
            hint="fix what the lines above report, then repeat the command: it computes only what failed",
        )
        if not result.failed:
            reasons = "; ".join(dict.fromkeys(row.not_applicable for row in result.units))
            failure = SimulshotError(
                f"nothing could be computed: {reasons}",
                hint="use bursts of two or more cameras that see the same scene",
            )
        failure.exit_code = code
        raise failure
