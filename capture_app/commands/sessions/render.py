"""`capture-app sessions render`: a simulated session from a recipe, reproducible to the byte."""

from pathlib import Path

import click
import msgspec

from capture_app.commands.options import ANY_PATH
from capture_app.commands.sessions.text import print_session
from capture_app.errors import BadInputError
from capture_app.terminal import json_option, print_json, print_line, show_count


@click.command()
@click.argument("recipes", metavar="RECIPE...", type=ANY_PATH, nargs=-1, required=True)
@click.option(
    "--out", type=ANY_PATH, default=Path("sessions"), metavar="DIR", help="Folder for the sessions."
)
@click.option("--name", show_default="that in the recipe", help="Name of the session.")
@click.option(
    "--retake",
    is_flag=True,
    help="Simulate the burst again instead of using the times recorded in the recipe.",
)
@click.option("--replace", is_flag=True, help="Replace an earlier rendering.")
@json_option
def render(
    recipes: tuple[Path, ...], out: Path, name: str | None, retake: bool, replace: bool, as_json: bool
) -> None:
    """Render simulated sessions. RECIPE is a recipe.json or a session that was rendered from one.

    Where the recipe has no frame times yet, a simulated rig takes the burst, and the recipe.json in the
    session records them. The same recipe always gives the same bytes.
    """
    from capture_app.samples.recipe import read_recipe
    from capture_app.samples.render import render as render_recipe

    if name is not None and len(recipes) > 1:
        raise BadInputError("--name is for one recipe", hint="render the recipes one by one")
    results = []
    for path in recipes:
        recipe = read_recipe(path)
        if name is not None:
            recipe = msgspec.structs.replace(recipe, name=name)
        if retake:
            recipe = msgspec.structs.replace(recipe, take=None)
        rendered = render_recipe(recipe, out, replace=replace, progress=show_count("images"))
        folder = str(rendered.session.folder)
        results.append({"session": folder, "same_bytes_as_before": rendered.same})
        if not as_json:
            if rendered.same is not None:
                print_line(f"{folder}: {'unchanged' if rendered.same else 'changed'}")
            else:
                print_session(rendered.session)
    if as_json:
        print_json({"sessions": results})
