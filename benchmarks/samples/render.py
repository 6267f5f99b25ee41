"""Rendering of a session from a recipe: takes the burst if the recipe has no take, and renders frames."""

import filecmp
from collections.abc import Callable
from pathlib import Path

import msgspec

from benchmarks.samples.recipe import CameraRecipe, Recipe, RecipeFrame, Take, Trigger
from benchmarks.samples.takes import take_naive, take_synchronized
from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name
from capture_app.plugins.cameras.sim.profiles import find_profile
from capture_app.plugins.cameras.sim.rendering.picture_source import PictureSource, open_picture_source
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.plugins.cameras.sim.simulation_driver import SimulatedPicture, encode_truth, stable_seed
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.files.untrusted_files import indented
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import RECIPE
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter

Progress = Callable[[int, int], None]
"""Called after each image with the number of images done and the total."""


def render(
    recipe: Recipe, root: Path, *, replace: bool = False, progress: Progress = lambda done, total: None
) -> tuple[Session, bool | None]:
    """Render the session root/name of a recipe; its own `recipe.json` then contains the take.

    Also returns whether an earlier session of the same bytes existed; None if there was no earlier one.
    `replace` overwrites an earlier rendering of that name. Raises BadInputError if another session is there,
    or if the recipe names something that the simulator lacks; NotAvailableError if scenes cannot be rendered.
    Nothing is left behind after an error.
    """
    check_name(recipe.name, "session")
    place = root / recipe.name
    with OutputFolder(place, _replaces_renderings if replace else replaces_nothing) as output:
        _write(recipe, output.folder, progress)
        same = same_files(output.folder, place) if replace and place.exists() else None
        if same:
            output.discard()
    return Session.open(place), same


def _replaces_renderings(place: Path) -> None:
    if not (place / RECIPE).is_file():
        raise BadInputError(f"{place} is not a rendered session, and is not replaced")


def same_files(one: Path, other: Path) -> bool:
    """Return whether two folders contain the same files with the same bytes."""
    names = {path.relative_to(one) for path in one.rglob("*") if path.is_file()}
    if names != {path.relative_to(other) for path in other.rglob("*") if path.is_file()}:
        return False
    return all(filecmp.cmp(one / name, other / name, shallow=False) for name in names)


def _write(recipe: Recipe, folder: Path, progress: Progress) -> None:
    sources = open_sources(recipe)
    take = recipe.take
    if take is None:
        taken_by = take_naive if recipe.trigger is Trigger.NAIVE else take_synchronized
        take = taken_by(recipe, sources)
    with SessionWriter(folder, recipe.name, recipe.created, take.software) as writer:
        for event in take.events:
            writer.add_event(event)
        frames = sorted(take.frames, key=lambda frame: (frame.instant, frame.camera))
        for done, frame in enumerate(frames, 1):
            _render_frame(writer, recipe, take, frame, sources[frame.camera])
            progress(done, len(frames))
        writer.images.clocks = dict(take.clocks)
        calibrated = {
            name: calibration
            for name, source in sources.items()
            if (calibration := source.calibration) is not None
        }
        if calibrated:
            source = f"the simulated scene {recipe.scene}"
            writer.set_calibration(Calibration(cameras=calibrated, source=source))
        data = msgspec.json.encode(msgspec.structs.replace(recipe, take=take))
        write_atomic(writer.folder / RECIPE, indented(data))
        writer.finish(take.cameras, take.burst, take.missing, "simulated", recipe.note)


def open_sources(recipe: Recipe) -> dict[str, PictureSource]:
    """Return the source of each camera's images. Raises as `render` does."""
    return {camera.name: _source(recipe, camera) for camera in recipe.cameras}


def _source(recipe: Recipe, camera: CameraRecipe) -> PictureSource:
    profile = find_profile(camera.profile)
    row_time_ns = profile.row_time_ns
    for taken in recipe.take.cameras if recipe.take else ():
        if taken.name == camera.name and taken.facts.row_time_ns is not None:
            row_time_ns = taken.facts.row_time_ns
    return open_picture_source(
        recipe.scene,
        camera.view,
        camera=camera.name,
        width=profile.image_width,
        height=profile.image_rows,
        row_time_ns=row_time_ns,
        scale=recipe.scale,
    )


def _render_frame(
    writer: SessionWriter, recipe: Recipe, take: Take, taken: RecipeFrame, source: PictureSource
) -> None:
    # Inputs of the image: its true start, its exposure and the seed of its noise.
    frame = SensorFrame(
        sequence=taken.sequence,
        stream=0,
        start_true_ns=taken.true_ns,
        timestamp_true_ns=taken.true_ns,
        readout_end_true_ns=taken.true_ns,
        exposure_ns=taken.exposure_ns,
        dropped=False,
    )
    seed = stable_seed(f"{recipe.seed}/{taken.camera}/{taken.true_ns}")
    (delay_ns,) = (camera.delay_ns for camera in take.cameras if camera.name == taken.camera)
    writer.add_image(
        SimulatedPicture(source, frame, seed, recipe.jpeg_quality).encode(),
        truth=encode_truth(source, frame) if recipe.depth else b"",
        **msgspec.structs.asdict(taken),
        residual_ns=taken.leader_ns - take.burst.instants_ns[taken.instant] - delay_ns,
        gain=1.0,
        white_balance=(1.0, 1.0),
    )
