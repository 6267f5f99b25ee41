"""`capture-app sessions render`: a session out of a recipe, the same bytes every time."""

import sys
from pathlib import Path

import click
import msgspec

from capture_app.commands.sessions.text import show_text
from capture_app.errors import BadInputError


@click.command()
@click.argument("recipes", metavar="RECIPE...", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("sessions"),
    show_default=True,
    help="Folder of sessions.",
)
@click.option("--name", help="Another name for the session.")
@click.option("--retake", is_flag=True, help="Let the engine take the burst anew, as it does today.")
@click.option("--replace", is_flag=True, help="Put it in the place of an earlier rendering.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def render(
    recipes: tuple[Path, ...], out: Path, name: str | None, retake: bool, replace: bool, as_json: bool
) -> None:
    """Render sessions from recipes: RECIPE is a recipe.json, or a session that was rendered from one.

    Without a take in the recipe, the engine synchronizes a virtual rig and takes the burst; the rendered
    session's recipe.json keeps it. The same recipe gives the same bytes.
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
        rendered = render_recipe(recipe, out, replace=replace, progress=_progress)
        folder = str(rendered.session.folder)
        results.append({"session": folder, "same_bytes_as_before": rendered.same})
        if not as_json:
            if rendered.same is not None:
                click.echo(f"{folder}: {'the same bytes as before' if rendered.same else 'changed'}")
            else:
                click.echo(show_text(rendered.session))
    if as_json:
        click.echo(msgspec.json.format(msgspec.json.encode({"sessions": results}), indent=2))


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        click.echo(f"\r{done} of {total} images" + ("\n" if done == total else ""), nl=False, err=True)
