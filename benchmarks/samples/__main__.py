"""Render simulated sessions: `python -m benchmarks.samples RECIPE...`."""

import sys
from collections.abc import Sequence
from pathlib import Path

import click
import msgspec

from benchmarks.samples.recipe import read_recipe
from benchmarks.samples.render import render as render_recipe
from capture_app.commands.session_text import session_lines
from capture_app.console.terminal import json_option, print_json, print_line, run_command_line, show_count

PATH = click.Path(path_type=Path)


@click.command()
@click.argument("recipes", metavar="RECIPE...", type=PATH, nargs=-1, required=True)
@click.option("--out", type=PATH, default=Path("sessions"), metavar="DIR", help="Folder for the sessions.")
@click.option("--retake", is_flag=True, help="Simulate the burst again instead of using its recorded times.")
@click.option("--replace", is_flag=True, help="Replace an earlier rendering.")
@json_option
def render(recipes: tuple[Path, ...], out: Path, retake: bool, replace: bool, as_json: bool) -> None:
    """Render simulated sessions. RECIPE is a recipe.json or a session that was rendered from one.

    Where the recipe has no frame times yet, a simulated rig takes the burst, and the recipe.json in the
    session records them. The same recipe always gives the same bytes with one Embree.
    """
    results = []
    for path in recipes:
        recipe = read_recipe(path)
        if retake:
            recipe = msgspec.structs.replace(recipe, take=None)
        session, same = render_recipe(recipe, out, replace=replace, progress=show_count("images"))
        folder = str(session.folder)
        results.append({"session": folder, "same_bytes_as_before": same})
        if not as_json:
            before = [f"{folder}: {'unchanged' if same else 'changed'}"]
            for line in session_lines(session) if same is None else before:
                print_line(line)
    if as_json:
        print_json({"sessions": results})


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; an error is one line on stderr."""
    return run_command_line(render, "python -m benchmarks.samples", arguments)


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
