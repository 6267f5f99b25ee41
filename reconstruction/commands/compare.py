"""`reconstruct compare` and `reconstruct tolerance`."""

from pathlib import Path
from typing import Any

import click

from capture_app.common.instants import COMPARED_MS
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import SESSION, FiniteRange, answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands import command_options
from reconstruction.method.interface import scored, study_names
from reconstruction.scene.conditions import MAX_OFFSET_MS, SYNCED, Condition


def _refuse_synced(
    ctx: click.Context, param: click.Parameter, value: tuple[Condition, ...]
) -> tuple[Condition, ...]:
    if any(condition.name == SYNCED for condition in value):
        raise click.BadParameter(f"{SYNCED} is part of every comparison; name another condition")
    return value


class _CompareCommand(RuledCommand):
    """Command with an option to choose studies, and the options of all installed studies."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the options; the methods describe them, without the studies that take long to load."""
        chosen = click.Option(
            ["--study", "studies"],
            type=click.Choice(study_names()),
            multiple=True,
            show_default="all",
            help="Make only this study and the studies it needs. Repeat for several.",
        )
        own = [option for options in scored() for option in command_options.click_options(options)]
        # With --study, the options of a study play a part if it, or one that needs it, is made.
        self.rules = [
            Rule(" ".join(option.opts[0] for option in options), f"!--study --study={'|'.join(studies)}")
            for kind in scored()
            if (options := [*command_options.click_options(kind)])
            and (studies := [kind.name, *(study.name for study in scored() if kind.name in study.needs)])
        ]
        params = super().get_params(ctx)
        out = [param.name for param in params].index("out")
        return [*params[:out], chosen, *own, *params[out:]]


@click.command(
    cls=_CompareCommand,
    epilog=examples("reconstruct compare sessions/burst-001 --offset-ms 66 --out compare"),
)
@command_options.session_argument
@click.option(
    "--offset-ms",
    type=FiniteRange(min=0, min_open=True, max=MAX_OFFSET_MS),
    metavar="MS",
    default=COMPARED_MS,
    help="Delay of the second camera of a pair, rounded to whole frames.",
)
@command_options.max_instants_option
@command_options.time_shift_option
@click.option(
    "--condition",
    "conditions",
    type=command_options.CONDITION,
    metavar="CONDITION",
    multiple=True,
    callback=_refuse_synced,
    help=f"Also compare with this condition. Repeat for several. {command_options.OFFSETS_HELP}",
)
@click.option(
    "--against",
    type=SESSION,
    metavar="SESSION",
    help="Also compare with another session of the same cameras, such as one without synchronization.",
)
@command_options.out_option
@json_option
def compare(session: Path, out: Path, as_json: bool, **chosen: Any) -> None:
    """Compare synchronized images of SESSION with images taken at different times.

    Writes metrics.json, pictures and a self-explanatory report.html to the --out folder.
    """
    from reconstruction.compare.comparison import CompareOptions
    from reconstruction.compare.comparison import compare as run

    result = run(session, out, CompareOptions.of(**chosen))
    answer(as_json, result, [result.verdict, f"report: {out / result.report}"])


@click.command(epilog=examples("reconstruct tolerance sessions/burst-001 --out tolerance"))
@command_options.session_argument
@click.option(
    "--max-offset-ms",
    type=FiniteRange(min=0, min_open=True, max=1e4),
    metavar="MS",
    default=COMPARED_MS,
    help="Largest delay to measure, in steps of one frame, as far as the burst allows.",
)
@click.option("--pair", **command_options.PAIR, help="The two cameras for depth.")
@command_options.max_instants_option
@command_options.time_shift_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for the curve, the numbers and a report.",
)
@json_option
def tolerance(session: Path, out: Path | None, as_json: bool, **options: Any) -> None:
    """Measure the delay of one camera at which the motion in SESSION spoils the depth."""
    from reconstruction.common.templates import render_lines
    from reconstruction.compare.tolerance_study import measure_tolerance
    from reconstruction.method.spoken import spoken

    result = measure_tolerance(session, out, **options)
    answer(
        as_json,
        result,
        render_lines(
            "tolerance.txt", "reconstruction.commands", result=spoken(result, result.labels), out=out
        ),
    )
