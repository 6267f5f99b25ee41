"""`capture-app cameras`: the values that `--camera` takes."""

import click

from capture_app.terminal import json_option, print_json, print_table


@click.command()
@json_option
def cameras(as_json: bool) -> None:
    """List the cameras of this machine and the simulated camera models."""
    from capture_app.cameras.catalog import list_cameras

    found = list_cameras()
    if as_json:
        print_json({"cameras": found})
    else:
        print_table(
            ("spec", "model", "detail"), [(camera.spec, camera.model, camera.detail) for camera in found]
        )
