"""Measures one camera: watches it, starts it again and again, and moves its phase by known commands."""

from collections.abc import Callable
from statistics import median

from msgspec.structs import replace

from capture_app.camera_facts import PhaseControl
from capture_app.cameras.base import Camera
from capture_app.clock import NodeClock
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.characterization.character import Character, Starts
from capture_app.node.characterization.moving import MOVES, measure_moves
from capture_app.node.characterization.stream_watch import StreamWatch
from capture_app.text import count

SETTLING_FRAMES = 40
"""Frames before anything is counted: a stream that has just begun may stutter."""
AFTER_START_FRAMES = 12
"""Frames watched after each start."""
GOLDEN = 0.618
"""Restarts begin at places of the period that are spread evenly, however many there are."""


async def characterize(
    spec: str,
    open_camera: Callable[[], Camera],
    clock: NodeClock,
    *,
    modes: str = "",
    seconds: float = 10.0,
    starts: int = 8,
    moves: int = MOVES,
    talk: Callable[[str], None] = lambda _: None,
) -> Character:
    """Open the camera of `spec` and measure it; `clock` is that of its stamps, `modes` what it offers.

    It is watched for so many seconds, started so many times, and told to move so many times. Raises
    CameraError where it cannot be opened or gives no frames, and what `open_camera` raises.
    """
    watch = StreamWatch(open_camera(), clock)
    latencies_ns: list[int] = []
    try:
        talk("starting")
        await watch.start()
        # A driver knows some of it only once it streams.
        facts = watch.camera.facts
        await watch.frames(SETTLING_FRAMES)
        watch.deliveries_ns.clear()
        wanted = max(SETTLING_FRAMES, round(seconds * 1e9 / facts.period_ns))
        talk(f"watching {count(wanted, 'frame')}")
        least_ns = most_ns = watch.exposure_ns
        for _ in range(wanted):
            await watch.frames(1)
            if watch.exposure_ns is not None and least_ns is not None and most_ns is not None:
                least_ns, most_ns = min(least_ns, watch.exposure_ns), max(most_ns, watch.exposure_ns)
        phase = watch.phase
        character = Character(
            spec=spec,
            camera=facts,
            modes=modes,
            frames=phase.frames,
            drops=phase.drops,
            period_ns=phase.period_ns,
            rate_error_ppm=(facts.period_ns / phase.period_ns - 1.0) * 1e6,
            stamp_step_ns=phase.quantum_ns,
            stamp_jitter_ns=phase.noise_ns,
            delivery_ns=round(median(watch.deliveries_ns)),
            slowest_delivery_ns=max(watch.deliveries_ns),
            exposures_ns=None if least_ns is None or most_ns is None else (least_ns, most_ns),
        )
        if moves and facts.phase_control in (PhaseControl.INJECTION, PhaseControl.FRAME_DURATION):
            talk(f"moving its phase {count(moves, 'time')}")
            character = replace(character, moves=await measure_moves(watch, facts, moves))
        by_restart = facts.phase_control is PhaseControl.RESET
        talk(f"starting it {count(starts, 'time')}")
        for number in range(starts):
            if by_restart:
                delay_ns = round(number * GOLDEN % 1.0 * facts.period_ns)
                latencies_ns.append(await watch.restart(delay_ns))
            else:
                await watch.camera.stop()
                watch = StreamWatch(open_camera(), clock)
                latencies_ns.append(await watch.start())
            await watch.frames(AFTER_START_FRAMES)
    finally:
        await watch.camera.stop()
    if not latencies_ns:
        return character
    return replace(character, starts=Starts(latencies_ns=tuple(latencies_ns), by_restart=by_restart))


def save(character: Character, profiles: DeviceProfiles) -> Character:
    """Keep what nodes use of it in this machine's profiles; return it with whether that was possible."""
    saved = False
    moves, starts = character.moves, character.starts
    if moves is not None and moves.injection is not None:
        saved = profiles.save_injection(character.camera, moves.injection)
    if starts is not None and starts.by_restart:
        period_ns = character.period_ns
        shares_ns = tuple(round(latency % period_ns) for latency in starts.latencies_ns)
        saved = profiles.save_start_latencies(character.camera, shares_ns)
    return replace(character, saved=saved)
