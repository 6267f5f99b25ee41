"""A camera that can only restart, used again: the start latencies of before aim its first restart."""

import random
from dataclasses import replace

from msgspec import structs

from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.rig.bench import Bench
from capture_app.sync.rig.phase_loop import ClientConfig, PhaseLoop

from .test_relays import CAMERA

STEADY = replace(PROFILES["webcam"], start_latency_ns=(275_000_000, 1_000_000))
RUNS = 24


def aligned(seed: int, starts_seen: tuple[int, ...] = ()) -> Bench:
    bench = Bench(STEADY, seed, 1_000_000, start_latencies_ns=starts_seen)
    while True:
        look = bench.deliver()
        if look is not None and look.aligned:
            return bench


def test_latencies_of_one_use_save_restarts_on_the_next() -> None:
    first = [aligned(seed) for seed in range(RUNS)]
    again = [aligned(seed, first[seed - 1].aligner.start_latencies_ns) for seed in range(RUNS)]
    restarts = [sum(bench.aligner.corrections for bench in benches) for benches in (first, again)]
    assert restarts[1] <= 0.9 * restarts[0]


def test_a_client_is_told_what_its_camera_did_before() -> None:
    camera = structs.replace(CAMERA, phase_control="reset")
    config = ClientConfig("cam", 1, camera, 2_000_000, 90, start_latencies_ns=(5_000_000, 6_000_000))
    assert PhaseLoop(config, random.Random(1)).aligner.start_latencies_ns == (5_000_000, 6_000_000)
    still = ClientConfig("cam", 1, CAMERA, 2_000_000, 90, start_latencies_ns=(5_000_000,))
    assert PhaseLoop(still, random.Random(1)).aligner.start_latencies_ns == ()
