"""`reconstruct multiview`."""

from pathlib import Path

import click

from capture_app.terminal import Progress, json_option, print_json, print_line, talk


class _Offsets(click.ParamType[tuple[float, ...]]):
    """Milliseconds with commas between, one for each camera."""

    name = "MS,MS,..."

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Split the text."""
        if isinstance(value, tuple):
            return value
        try:
            return tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is not milliseconds with commas between, as in 66,-33,0,33,-66", param, ctx)


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--instant", type=click.IntRange(min=0), default=0, show_default=True, help="Instant of the burst."
)
@click.option(
    "--offsets-ms",
    type=_Offsets(),
    default=(),
    help="Take each camera's image so much later, ms, in the session's order [default: all of the instant].",
)
@click.option(
    "--matcher",
    type=click.Choice(["auto", "sweep", "patchmatch"]),
    default="auto",
    show_default=True,
    help="sweep: on the CPU. patchmatch: COLMAP's, on an NVIDIA GPU. auto: that where there is one.",
)
@click.option("--mesh/--no-mesh", default=True, show_default=True, help="Also make a mesh and its picture.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the result.")
@json_option
def multiview(
    session: Path,
    instant: int,
    offsets_ms: tuple[float, ...],
    matcher: str,
    mesh: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Make depth maps of all cameras of one instant of SESSION, a cloud of points and a mesh."""

    from reconstruction.multiview.command import Matcher, MultiviewOptions
    from reconstruction.multiview.command import multiview as run

    options = MultiviewOptions(instant=instant, offsets_ms=offsets_ms, matcher=Matcher(matcher), mesh=mesh)
    result = run(session, out, options, Progress(1))
    for camera, why in result.left_out.items():
        talk(f"{camera} is left out: {why}")
    if as_json:
        print_json(result)
        return
    print_line(f"{len(result.views)} depth maps, {result.fused_points} points in {result.seconds:.1f} s")
    if result.within_2pct is not None:
        print_line(
            f"{result.reference}: {100 * result.within_2pct:.1f} % of its pixels within 2 % of the truth"
        )
    print_line(f"result: {out}")
