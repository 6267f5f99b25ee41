"""A burst taken by the engine in virtual time, or naively: each camera takes what follows a message.

The message's delays follow the paper's naive WiFi trigger (section 5: mean 123 ms, standard deviation 84 ms,
at most 677 ms), as a Gamma law; nothing aligns the streams.
"""

import random
from collections.abc import Mapping
from dataclasses import replace

from benchmarks.samples.recipe import CameraRecipe, Recipe, RecipeFrame, Take
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from capture_app import __version__
from capture_app.common.clock import SimulatedClock, seeded_clock
from capture_app.common.errors import IncompleteError
from capture_app.common.stagger import Stagger
from capture_app.node.burst.plans import burst_record
from capture_app.node.camera.camera_node import camera_record
from capture_app.plugins.cameras.sim.profiles import SensorProfile, facts_of, find_profile
from capture_app.plugins.cameras.sim.rendering.picture_source import PictureSource
from capture_app.plugins.cameras.sim.sensor import Sensor, SensorFrame
from capture_app.protocol.event_text import client_record
from capture_app.protocol.messages import EventValue
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.sync.rig.frame_selection import DROPPED, FramesSelected

_READY_WITHIN_NS = 120_000_000_000
_PICKED_WITHIN_NS = 30_000_000_000
"""Timeout of the picking after the burst's last instant."""
_ORDERED_AHEAD_NS = 200_000_000
_STARTS_APART_NS = 150_000_000


def take_synchronized(
    recipe: Recipe, sources: Mapping[str, PictureSource], stagger: Stagger | None = None
) -> Take:
    """Let a rig of the recipe's cameras synchronize, align (in step, or by `stagger`) and take the burst.

    Raises BadInputError for a profile that does not exist, IncompleteError if the rig never becomes ready.
    """
    specs = [
        NodeSpec(
            camera.name,
            profile_of(recipe, camera, sources[camera.name]),
            seeded_clock(f"{camera.name} of {recipe.seed}"),
            start_true_ns=number * _STARTS_APART_NS,
        )
        for number, camera in enumerate(recipe.cameras)
    ]
    rig = VirtualRig(specs, seed=recipe.seed, stagger=stagger)
    log = _Log(rig)
    ready = rig.run_until(
        lambda: log.follow() or (len(rig.nodes) == len(specs) and rig.all_usable()), limit_ns=_READY_WITHIN_NS
    )
    if not ready:
        raise IncompleteError(f"the rig of {recipe.name} was not ready after {_READY_WITHIN_NS / 1e9:g} s")
    at_leader_ns = max(round(recipe.at_s * 1e9), rig.now_true_ns + _ORDERED_AHEAD_NS)
    wait_ns = at_leader_ns - _ORDERED_AHEAD_NS - rig.now_true_ns
    rig.run_until(log.follow, limit_ns=wait_ns)
    burst = rig.trigger(frames=recipe.frames, spacing=recipe.spacing, at_leader_ns=at_leader_ns)
    nodes = [rig.nodes[camera.name] for camera in recipe.cameras]
    # As many instants again may replace instants that a camera dropped.
    longest_ns = 2 * recipe.frames * recipe.spacing * max(spec.profile.period_ns for spec in specs)
    picked = rig.run_until(
        lambda: log.follow() or all(burst.number in node.bursts for node in nodes),
        limit_ns=_PICKED_WITHIN_NS + longest_ns,
    )
    if not picked:
        raise IncompleteError(f"not all cameras of {recipe.name} took the burst")
    readies = {node.spec.name: node.bursts[burst.number] for node in nodes}
    records = {node.spec.name: _camera_record(node, readies[node.spec.name], sources) for node in nodes}
    clocks = ((node.spec.name, node.spec.clock) for node in nodes)
    return Take(
        software=f"simulshot {__version__}",
        cameras=tuple(records.values()),
        burst=burst_record(burst),
        frames=tuple(f for name, of in readies.items() for f in _frames(records[name], of)),
        missing=tuple(
            MissingImage(camera=name, instant=gap.instant, reason=gap.reason, dropped=gap.reason == DROPPED)
            for name, of in readies.items()
            for gap in of.gaps
        ),
        events=tuple(log.lines),
        clocks={name: clock for name, clock in clocks if isinstance(clock, SimulatedClock)},
    )


def profile_of(recipe: Recipe, camera: CameraRecipe, source: PictureSource) -> SensorProfile:
    """Return the camera's model with the recipe's exposure and the view's rows. Raises BadInputError."""
    exposure_ns = round(recipe.exposure_ms * 1e6)
    return replace(find_profile(camera.profile), exposure_ns=exposure_ns, image_rows=source.height)


class _Log:
    """The events of the clients' engines in chronological order."""

    def __init__(self, rig: VirtualRig) -> None:
        self.lines: list[dict[str, EventValue]] = []
        self._rig = rig
        self._seen: dict[str, int] = {}

    def follow(self) -> bool:
        """Add the new events; always return False, as a condition that never ends a run."""
        for name, node in self._rig.nodes.items():
            for event in node.events[self._seen.get(name, 0) :]:
                if not isinstance(event, FramesSelected):
                    local_ns = node.spec.clock.local_from_true(self._rig.now_true_ns)
                    self.lines.append({"camera": name, "local_ns": local_ns, **client_record(event)})
            self._seen[name] = len(node.events)
        return False


def _camera_record(
    node: VirtualNode, ready: FramesSelected[SensorFrame], sources: Mapping[str, PictureSource]
) -> CameraRecord:
    spec = node.spec
    source = sources[spec.name]
    facts = facts_of(spec.profile, width=source.width, height=source.height)
    client = node.client
    return camera_record(
        spec.name,
        facts,
        ready,
        client.aligner.corrections,
        client.config.phase_tolerance_ns,
        delay_ns=client.delay_ns,
    )


def _frames(camera: CameraRecord, ready: FramesSelected[SensorFrame]) -> list[RecipeFrame]:
    return [
        RecipeFrame(
            camera=camera.name,
            instant=pick.instant,
            sequence=pick.frame.sequence,
            true_ns=pick.frame.start_true_ns,
            local_ns=pick.local_ns,
            leader_ns=pick.leader_ns,
            exposure_ns=pick.frame.exposure_ns,
            exposure_start_ns=camera.facts.exposure_start_ns(pick.stamp_leader_ns, pick.frame.exposure_ns),
            uncertainty_ns=pick.uncertainty_ns,
            hard_bound_ns=pick.hard_bound_ns,
            outlier_ns=pick.outlier_ns,
            late=camera.is_late(pick.residual_ns),
        )
        for pick in ready.frames
    ]


MEAN_MS, DEVIATION_MS, LONGEST_MS = 123.0, 84.0, 677.0


def take_naive(recipe: Recipe, sources: Mapping[str, PictureSource]) -> Take:
    """Let the recipe's cameras stream without alignment, and take frames when each one's message arrives.

    The session's times are what the sender believes: all images of an instant at the time it was ordered,
    without a local clock that contradicts it. Raises BadInputError for a profile that does not exist.
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
    """Return the frames that start at or after the message's arrival, at the recipe's spacing."""
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
