"""A burst as it is taken without synchronization: a message goes out, and each camera takes what comes next.

The message's delays follow the naive WiFi trigger of the paper (section 5: mean 123 ms, standard deviation
84 ms, at most 677 ms), as a Gamma law; nothing aligns the streams.
"""

import random
from collections.abc import Mapping

from capture_app import __version__
from capture_app.clock import seeded_clock
from capture_app.samples.engine_take import profile_of
from capture_app.samples.recipe import CameraRecipe, Recipe, RecipeFrame, Take
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.simulation.devices.profiles import facts_of
from capture_app.simulation.devices.sensor import Sensor, SensorFrame
from capture_app.simulation.rendering.picture_source import PictureSource
from capture_app.sync.rig.frame_picks import DROPPED

MEAN_MS, DEVIATION_MS, LONGEST_MS = 123.0, 84.0, 677.0


def take_naive(recipe: Recipe, sources: Mapping[str, PictureSource]) -> Take:
    """Let the recipe's cameras stream without alignment, and take frames when each one's message arrives.

    The session's times are what the sender believes: all images of an instant when it was ordered, with no
    local clock to tell otherwise. Raises BadInputError for a profile that does not exist.
    """
    rng = random.Random(recipe.seed)
    requested_ns = round(recipe.at_s * 1e9)
    cameras = tuple(_record(recipe, camera, sources[camera.name]) for camera in recipe.cameras)
    clocks = {camera.name: seeded_clock(f"{camera.name} of {recipe.seed}") for camera in cameras}
    period_ns = cameras[0].facts.period_ns
    step_ns = recipe.spacing * period_ns
    instants_ns = tuple(requested_ns + number * step_ns for number in range(recipe.frames))
    frames: list[RecipeFrame] = []
    missing: list[MissingImage] = []
    for camera in recipe.cameras:
        taken = _taken(recipe, camera, sources[camera.name], requested_ns + _delay_ns(rng), rng)
        for instant, frame in enumerate(taken):
            if frame.dropped:
                gap = MissingImage(camera=camera.name, instant=instant, reason=DROPPED, dropped=True)
                missing.append(gap)
                continue
            frames.append(
                RecipeFrame(
                    camera=camera.name,
                    instant=instant,
                    sequence=frame.sequence,
                    true_ns=frame.start_true_ns,
                    local_ns=clocks[camera.name].local_from_true(frame.timestamp_true_ns),
                    leader_ns=instants_ns[instant],
                    exposure_ns=frame.exposure_ns,
                )
            )
    return Take(
        software=f"simulshot {__version__}",
        cameras=cameras,
        burst=BurstRecord(instants_ns=instants_ns, period_ns=period_ns, requested_ns=requested_ns),
        frames=tuple(frames),
        missing=tuple(missing),
        clocks=clocks,
    )


def _delay_ns(rng: random.Random) -> int:
    shape = (MEAN_MS / DEVIATION_MS) ** 2
    return round(min(rng.gammavariate(shape, MEAN_MS / shape), LONGEST_MS) * 1e6)


def _taken(
    recipe: Recipe, camera: CameraRecipe, source: PictureSource, arrival_ns: int, rng: random.Random
) -> list[SensorFrame]:
    """The frames that begin at or after the message's arrival, at the recipe's spacing."""
    profile = profile_of(recipe, camera, source)
    sensor = Sensor(profile, random.Random(rng.getrandbits(64)))
    sensor.start(rng.randrange(profile.period_ns))
    frame = sensor.next_frame()
    while frame.start_true_ns < arrival_ns:
        frame = sensor.next_frame()
    taken = [frame]
    while len(taken) < recipe.frames:
        for _ in range(recipe.spacing):
            frame = sensor.next_frame()
        taken.append(frame)
    return taken


def _record(recipe: Recipe, camera: CameraRecipe, source: PictureSource) -> CameraRecord:
    profile = profile_of(recipe, camera, source)
    facts = facts_of(profile, width=source.width, height=source.height)
    return CameraRecord(name=camera.name, facts=facts)
