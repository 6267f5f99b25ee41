"""The memory budget: what takes more is made smaller, and said; and pairs that cannot be rectified."""

import ctypes
import json
import os
import resource
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture_app.common import system
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import resize_view
from reconstruction.common.memory import (
    MEMORY,
    MIN_BYTES,
    MemoryBudget,
    limited_memory,
    memory_budget,
    parse_size,
)
from reconstruction.common.worker_pool import max_workers, worker_count
from reconstruction.methods.stereo.stereo_pair import StereoPair, rectify
from reconstruction.scene.pairs import Features, canvas_bounds, choose_stereo_pair
from tests.unit.reconstruction.conftest import Reconstruct, Scene, make_view


@pytest.mark.parametrize(("text", "size"), [("800MB", 8e8), ("4G", 4e9), ("1.5 GiB", 1.5 * 2**30)])
def test_sizes_are_read(text: str, size: float) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "4", "GB", "-1GB", "nan GB", "1e3MB"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="not a size of memory"):
        parse_size(text)


def test_the_environment_asks_for_a_budget(monkeypatch: pytest.MonkeyPatch, reconstruct: Reconstruct) -> None:
    monkeypatch.setenv(MEMORY, "2GB")
    assert (memory_budget().limit_bytes, memory_budget().asked_for) == (2_000_000_000, True)
    monkeypatch.setenv(MEMORY, "much")
    refused = reconstruct("board", "board.pdf")
    assert refused.code == 3
    assert "'much' is not a size of memory" in refused.complaint


def test_what_fits_is_left_as_it_is_and_what_does_not_is_made_smaller_and_said() -> None:
    with limited_memory(10**9) as budget:
        assert memory_budget() is budget
        assert budget.fit_scale("a volume", lambda scale: 9e8 * scale**3) == 1.0
        assert budget.notes == ()
        scale = budget.fit_scale("a volume", lambda scale: 8e9 * scale**3)
        assert 8e9 * scale**3 <= 1e9 < 8e9 * (1.2 * scale) ** 3
        notes: tuple[str, ...] = budget.notes
        (note,) = notes
        assert "8.0 GB" in note
        assert "1.0 GB" in note
        assert budget.fit_count(3e8, 8) == 3
        with pytest.raises(BadInputError, match=r"takes 90000\.0 GB"):
            budget.fit_scale("a world", lambda scale: 9e13 * scale**3)


def test_the_size_of_images_follows_from_memory_and_not_from_cores() -> None:
    """Before, depth from all cameras had smaller images where more cores would have shared the memory."""
    cores = os.sched_getaffinity(0)
    with limited_memory(2 << 30):
        held = max_workers()
        os.sched_setaffinity(0, {min(cores)})
        try:
            assert (max_workers(), worker_count()) == (held, 1)
        finally:
            os.sched_setaffinity(0, cores)


def test_depth_at_a_smaller_scale_is_still_right(scene: Scene) -> None:
    reference, other = (resize_view(make_view((x, 0, 0)), 1280, 960) for x in (0, 0.2))
    image, truth, _ = scene.look(make_view((0, 0, 0)), 0)
    partner = scene.look(make_view((0.2, 0, 0)), 0)[0]
    with limited_memory(1 << 30) as budget:
        whole = StereoPair(reference, other, (16.0, 240.0))
        assert whole.scale == 1.0
        assert budget.notes == ()
    with limited_memory(128 << 20) as budget:
        small = StereoPair(reference, other, (16.0, 240.0))
    assert small.scale < 0.7
    assert "of the full size" in budget.notes[0]
    large = (cv2.resize(grey, (1280, 960), interpolation=cv2.INTER_CUBIC) for grey in (image, partner))
    found = cv2.resize(small.compute_depth(*large).depth, (320, 240), interpolation=cv2.INTER_NEAREST)
    right = np.abs(found - truth) < 0.02 * truth
    assert right[found > 0].mean() > 0.85
    assert (found > 0).mean() > 0.7


def test_the_process_s_own_limit_counts() -> None:
    code = "from reconstruction.common.memory import free_memory; print(free_memory())"

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, preexec_fn=limit)
    assert 0 < json.loads(done.stdout) < 2 << 30


def test_pairs_that_cannot_be_rectified_are_left_out_with_a_number() -> None:
    at_home = make_view((0, 0, 0))
    views = {"a": at_home, "same": make_view((1e-9, 0, 0)), "turned": make_view((0.4, 0, 1.0), yaw=-110)}
    nothing = {
        name: Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0)) for name in views
    }
    choice = choose_stereo_pair(views, nothing)
    assert choice.cameras is None
    assert "same place by the calibration (baseline 1e-09)" in choice.left_out["a,same"]
    assert "110 degrees apart" in choice.left_out["a,turned"]
    assert choice.left_out["a,same"] in choice.why


def test_a_canvas_that_explodes_is_refused_with_its_size() -> None:
    view = make_view((0, 0, 0))
    wide = replace(view, matrix=view.matrix * [[0.8], [0.8], [1]])
    with pytest.raises(ValueError, match=r"320x240 pixels would become 2189x1747 \(baseline 0.566"):
        rectify(wide, make_view((0.4, 0, 0.4)), (0, 16))
    low, high = canvas_bounds(wide, make_view((0.4, 0, 0.1), yaw=20))
    assert ((high - low) < (800, 600)).all()


def test_threads_side_by_side_keep_to_the_budget_together() -> None:
    budget = MemoryBudget(MIN_BYTES)
    together = threading.Barrier(2)
    used, most = [0], [0]

    def meet(_: int) -> None:
        with budget.reserved(0.5 * MIN_BYTES):
            together.wait(30)

    def work(fraction: float) -> None:
        with budget.reserved(fraction * MIN_BYTES):
            used[0] += 1
            most[0] = max(most[0], used[0])
            used[0] -= 1

    with ThreadPoolExecutor(4) as pool:
        assert len(list(pool.map(meet, range(8)))) == 8
        assert len(list(pool.map(work, [0.6, 3.0] * 20))) == 40
    assert most == [1]


SHARING = """
import ctypes, threading
from capture_app.common import system
system.limit_heaps(len(system.usable_cores()))
libc, together = ctypes.CDLL(None), threading.Barrier(9)
libc.malloc.restype = libc.fopen.restype = ctypes.c_void_p
def work():
    libc.malloc(1000), together.wait(), together.wait()
for _ in range(8):
    threading.Thread(target=work).start()
together.wait()
out = ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w"))
libc.malloc_info(0, out), libc.fclose(out)
together.wait()
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_info"), reason="not glibc")
def test_threads_share_a_heap_a_core() -> None:
    said = subprocess.run([sys.executable, "-c", SHARING], capture_output=True, text=True, check=True).stdout
    assert 1 <= said.count("<heap ") <= len(system.usable_cores())
