"""Careless faults that are put into the product's own text, one at a time, to show that seeds find them.

A fault replaces a piece of a function's source, which is compiled again and given to the live function. Where
the product no longer has that text, planting fails: the fault has to be written anew.
"""

import ast
import contextlib
import importlib
import inspect
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import capture_app
from tests.virtual.plan import TWICE, Plan, draw

CHECKOUT = Path(capture_app.__file__).parents[1]
TRIED = 100
"""Fitting seeds within which each fault has to be found."""


class PlantError(Exception):
    """The product's text has changed where a fault was to be put."""


@dataclass(frozen=True)
class Fault:
    """A careless change of the product."""

    what: str
    """What the product does wrongly with it."""
    file: str
    """Path below the checkout."""
    before: str
    """Text of one function, in the file once."""
    after: str
    fits: Callable[[Plan], bool] = lambda _: True
    """Whether a plan has what the fault needs to show."""
    seed: int | None = None
    """A seed that finds it, for the faults that the system tests plant."""

    @cached_property
    def _codes(self) -> tuple[FunctionType, CodeType]:
        """The live function, and its code with the fault."""
        path = CHECKOUT / self.file
        text = path.read_text()
        if (found := text.count(self.before)) != 1:
            raise PlantError(
                f"{self.file} has {found} times instead of once: {self.before.strip()!r};"
                " the product has changed: write this fault anew in tests/virtual/planted.py"
            )
        line = text[: text.index(self.before)].count("\n") + 1 + (self.before[0] == "\n")
        name = _function_at(ast.parse(text), line)
        if not name:
            raise PlantError(f"{self.file}:{line} is in no function: a fault has to change one")
        code = code_of(compile(text.replace(self.before, self.after), str(path), "exec"), name)
        module = importlib.import_module(self.file.removesuffix(".py").replace("/", "."))
        function = live_function(module, name)
        if inspect.getsourcefile(function) != str(path):
            raise PlantError(f"{name} of {self.file} is the function of another file")
        return function, code

    @contextlib.contextmanager
    def planted(self) -> Iterator[None]:
        """Put the fault into the product within the block. Raises PlantError where its text has changed."""
        function, code = self._codes
        before, function.__code__ = function.__code__, code
        try:
            yield
        finally:
            function.__code__ = before


def _function_at(tree: ast.AST, line: int, names: tuple[str, ...] = ()) -> str:
    """Return the qualified name of the outermost function that has this line; empty for none."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if not node.lineno <= line <= (node.end_lineno or 0):
                continue
            here = (*names, node.name)
            return _function_at(node, line, here) if isinstance(node, ast.ClassDef) else ".".join(here)
    return ""


def code_of(code: CodeType, name: str) -> CodeType:
    """Return the code of a function by its qualified name, in a module's code."""
    for part in name.split("."):
        found = [of for of in code.co_consts if isinstance(of, CodeType) and of.co_name == part]
        # The last of several, such as a property's setter, would be another function than the live one.
        assert len(found) == 1, f"{name} is defined {len(found)} times"
        code = found[0]
    return code


def live_function(module: Any, name: str) -> FunctionType:
    """Return the function that runs, below its decorators."""
    found = module
    for part in name.split("."):
        found = inspect.getattr_static(found, part)
    if isinstance(found, property | cached_property):
        found = found.fget if isinstance(found, property) else found.func
    found = inspect.unwrap(getattr(found, "__func__", found))
    assert isinstance(found, FunctionType), f"{name} is no function"
    return found


def _has(*kinds: str) -> Callable[[Plan], bool]:
    """Return a test of plans for steps of these kinds, one of each."""
    return lambda plan: {*kinds} <= {step.kind for step in plan.steps}


def _befalls(kinds: tuple[str, ...], *targets: str) -> Callable[[Plan], bool]:
    """Return a test of plans for one of these faults on a machine whose name starts so."""
    return lambda plan: any(step.kind in kinds and step.target.startswith(targets) for step in plan.steps)


def _loses_power_while_it_saves(plan: Plan) -> bool:
    return _befalls(("power",), "lead")(plan) and _befalls(("disk-slow",), "lead")(plan)


def _restarts_all(plan: Plan) -> bool:
    """Return whether all cameras are started again at once, as during a recording."""
    ends = Counter(step.at_s for step in plan.steps if step.kind in ("kill", "power", "stop"))
    return any(number >= len(plan.cameras) for number in ends.values())


def _restarts_all_slow(plan: Plan) -> bool:
    """Return whether a camera of those has frames left, over a slow link, when it is asked for the rest."""
    return _restarts_all(plan) and any(
        step.kind == "slow-link"
        and step.target in plan.cameras
        and any(
            other.kind in ("kill", "power", "stop")
            and other.target == step.target
            and step.at_s <= other.at_s
            and other.at_s + other.seconds + 20 <= step.at_s + step.seconds
            for other in plan.steps
        )
        for step in plan.steps
    )


def _restarts_all_at_end(plan: Plan) -> bool:
    """Return whether all cameras are away when a recording of an ordered length ends."""
    ends_s = [step.at_s + step.value for step in plan.steps if step.kind == "recording" and step.value]
    away = [step for step in plan.steps if step.kind in ("kill", "power", "stop")]
    return any(
        {step.target for step in away if step.at_s < end_s - 0.5 and end_s + 1 < step.at_s + step.seconds}
        >= {*plan.cameras}
        for end_s in ends_s
    )


_ENDS = ("kill", "power", "kill-at-disk-step")
FAULTS: dict[str, Fault] = {
    "bar": Fault(
        "the 95 % uncertainty of an image's time is halved",
        "capture_app/sync/rig/frame_selection.py",
        "uncertainty_ns=round(uncertainty_ns + self.accuracy.uncertainty_ns)",
        "uncertainty_ns=round((uncertainty_ns + self.accuracy.uncertainty_ns) / 2)",
        seed=0,
    ),
    "wide-bar": Fault(
        "the 95 % uncertainty of an image's time is four times as large as it is",
        "capture_app/sync/rig/frame_selection.py",
        "uncertainty_ns=round(uncertainty_ns + self.accuracy.uncertainty_ns)",
        "uncertainty_ns=round(4 * (uncertainty_ns + self.accuracy.uncertainty_ns))",
    ),
    "bound": Fault(
        "the hard bound of an image's time is halved",
        "capture_app/sync/rig/frame_selection.py",
        "bound_ns = round(time_map.hard_bound_at(local_ns) + error.hard_bound_ns)",
        "bound_ns = round((time_map.hard_bound_at(local_ns) + error.hard_bound_ns) / 2)",
        lambda plan: bool(plan.lopsided),
    ),
    "skew": Fault(
        "a node's time map forgets that clocks run at different rates",
        "capture_app/sync/clock/time_map.py",
        "self.offset_ns + round(self.skew * (local_ns - self.epoch_local_ns))",
        "self.offset_ns",
    ),
    "ring": Fault(
        "a frame gets the timestamp of the next one",
        "capture_app/sync/rig/frame_selection.py",
        "        return None if nearest is None else nearest[:2]\n",
        "        if nearest is None:\n            return None\n        entries = list(self._entries)\n"
        "        return nearest[0], entries[max(0, entries.index(nearest) - 1)][1]\n",
    ),
    "early": Fault(
        "a frame is looked for before it can have arrived",
        "capture_app/sync/rig/frame_selection.py",
        "newest_ns > target_ns + after_ns",
        "newest_ns > target_ns - 3 * period_ns",
    ),
    "trigger-once": Fault(
        "a trigger is sent once and never again",
        "capture_app/sync/rig/burst_orders.py",
        "            burst.due_ns = now_ns + TRIGGER_AGAIN_NS\n",
        "            burst.due_ns = now_ns + 10 * TRIGGER_GIVE_UP_NS\n",
        lambda plan: plan.wifi,
    ),
    "absent": Fault(
        "the verdict ignores a camera that is lost",
        "capture_app/node/leader/bursts.py",
        "in (self._lost_cameras() | without).items()",
        "in without.items()",
        _befalls((*_ENDS, "cut", "freeze"), "cam", "relay"),
        seed=6,
    ),
    "words": Fault(
        "the operator's words leave out missing images",
        "capture_app/node/burst/burst_session.py",
        "        self.message = result_text(burst, missing, titles)",
        "        self.message = result_text(burst, [], titles)",
    ),
    "count": Fault(
        "an operator is told of as many images as were ordered",
        "capture_app/node/burst/burst_session.py",
        "received, expected = sum(t.received for t in transfer), sum(t.expected for t in transfer)",
        "received = expected = sum(t.expected for t in transfer)",
    ),
    "last-frame": Fault(
        "a recording ends without the time for all to learn of it",
        "capture_app/node/leader/bursts.py",
        "bisect_right(burst.instants_ns, now_ns + END_LEAD_NS)",
        "bisect_right(burst.instants_ns, now_ns)",
        _has("recording"),
        seed=2,
    ),
    "never-removed": Fault(
        "a finished burst is never removed from the leader's memory",
        "capture_app/node/leader/bursts.py",
        "            del self._bursts[number]\n",
        "            pass\n",
        seed=0,
    ),
    "ring-grows": Fault(
        "a node's ring buffer keeps frames for a minute instead of three seconds",
        "capture_app/sync/rig/frame_selection.py",
        "abs(local_ns - self._entries[0][0]) > self._span_ns",
        "abs(local_ns - self._entries[0][0]) > 20 * self._span_ns",
    ),
    "left-in-spool": Fault(
        "a node never deletes the spool folder of a finished burst",
        "capture_app/node/camera/uploader.py",
        "            burst.end()\n            await self._remove_spooled(burst)\n",
        "            burst.end()\n",
    ),
    "spool-sync": Fault(
        "the node's spool is never synced",
        "capture_app/node/camera/spool.py",
        "sync_all(files).values()",
        "sync_all(()).values()",
        _befalls(("power",), "cam"),
        seed=8,
    ),
    "sync-on-loop": Fault(
        "a node syncs its spool on its event loop",
        "capture_app/node/camera/uploader.py",
        "await asyncio.to_thread(spooled.sync)",
        "spooled.sync()",
    ),
    "journal-sync": Fault(
        "the leader does not sync a session's journal",
        "capture_app/session/writing/image_store.py",
        "self._journal.append(*(line for _, line, _ in begun.values()), durable=True)",
        "self._journal.append(*(line for _, line, _ in begun.values()), durable=False)",
        _befalls(("power",), "lead"),
    ),
    "rename-sync": Fault(
        "a file that replaces another is not synced into its folder",
        "capture_app/session/files/durable.py",
        "    if synced:\n        sync_folder(path.parent)\n",
        "",
        _befalls(("power",), "lead"),
    ),
    "early-ack": Fault(
        "the leader acknowledges an image before it is on the disk",
        "capture_app/node/burst/intake.py",
        "            await on_disk(self._disk, append)\n"
        "            arriving.pop(first, None)\n"
        "            self._bytes[camera] += len(data)\n"
        "            self._images[camera] += len(batch.images)\n"
        "            loop = asyncio.get_running_loop()\n"
        "            saved: asyncio.Future[str] = loop.create_future()\n",
        "            loop = asyncio.get_running_loop()\n"
        "            saved: asyncio.Future[str] = loop.create_future()\n"
        "            saved.set_result(batch.sha256)\n"
        "            saved.writing = loop.create_task(on_disk(self._disk, append))\n",
        _loses_power_while_it_saves,
        seed=34,
    ),
    "sent-is-safe": Fault(
        "a node deletes an image when it is sent instead of when it is acknowledged",
        "capture_app/node/camera/uploader.py",
        "        await self._channel.send(batch, *data, stall_s=UPLOAD_ANSWER_TIMEOUT_S)\n",
        "        await self._channel.send(batch, *data, stall_s=UPLOAD_ANSWER_TIMEOUT_S)\n"
        "        await _delete(burst.confirm({image.record.instant: image.sha256 for image in images}))\n",
        _befalls((*_ENDS, "cut"), "lead"),
    ),
    "retry": Fault(
        "a node whose stream breaks off waits for ever before it opens another one",
        "capture_app/node/camera/uploader.py",
        "                await asyncio.sleep(self._retry_s[min(failures, len(self._retry_s) - 1)])\n",
        "                await asyncio.sleep(1e6)\n",
    ),
    "stale": Fault(
        "a report that says nothing new counts as progress of its camera",
        "capture_app/node/burst/camera_delivery.py",
        "        else:\n            self.since_ns = max(self.since_ns, now_ns)\n        self.plan =",
        "        self.since_ns = max(self.since_ns, now_ns)\n        self.plan =",
        lambda plan: bool(plan.liars),
    ),
    "timeout": Fault(
        "a leader waits for ever for a camera that sends nothing",
        "capture_app/node/burst/camera_delivery.py",
        'f"it sent nothing for {stalled_ns // 10**9} s" if now_ns - since_ns >= stalled_ns else ""',
        '""',
        lambda plan: bool(plan.liars),
    ),
    "cancelled": Fault(
        "a cancelled take drops the images that had arrived",
        "capture_app/node/burst/burst_session.py",
        "if self.is_empty() and self._lost is None and not any(delivery.silent for delivery in deliveries):",
        "if self._lost is None and not any(delivery.silent for delivery in deliveries) and missing:",
        _has("cancel"),
    ),
    "mark": Fault(
        "a mark before the last second of a take counts as outside of it",
        "capture_app/node/burst/burst_session.py",
        "            and instants_ns[0] - MARK_MARGIN_NS <= leader_ns <= instants_ns[-1] + MARK_MARGIN_NS\n",
        "            and instants_ns[0] <= leader_ns <= instants_ns[-1] - MARK_MARGIN_NS\n",
        _has("mark"),
    ),
    "stagger": Fault(
        "a staggered camera's frame is selected as if it had no planned delay",
        "capture_app/sync/rig/frame_selection.py",
        "time_map.local_from_leader(instant_ns + self.delay_ns) - self.offset_ns",
        "time_map.local_from_leader(instant_ns) - self.offset_ns",
        lambda plan: bool(plan.stagger),
    ),
    "left-off": Fault(
        "a recording is over once all its cameras were started again",
        "capture_app/node/burst/camera_delivery.py",
        "        return is_over and (self.plan.picked or 0) < frames",
        "        return False",
        _restarts_all,
    ),
    "not-asked-again": Fault(
        "a camera that is ready again is not asked for the rest of a recording",
        "capture_app/sync/rig/burst_orders.py",
        "            if member.name in clients:\n                order =",
        "            if not clients:\n                order =",
        _restarts_all,
    ),
    "rest-not-asked": Fault(
        "a leader that is started again asks nobody for the rest of a recording",
        "capture_app/node/leader/bursts.py",
        "            self._engine.resume(session.burst, run, session.planned_delays_ns(), now_ns)\n",
        "            pass\n",
        _restarts_all,
    ),
    "second-upload": Fault(
        "a restarted camera's recording becomes a second upload in one spool folder",
        "capture_app/node/camera/uploader.py",
        "                burst.continue_from(left)\n",
        "                continue\n",
        _restarts_all_slow,
    ),
    "here-is-missing": Fault(
        "what a restarted camera lacks and the leader has counts as missing",
        "capture_app/node/burst/camera_delivery.py",
        "            if number not in self.instants\n",
        "            if number not in self.instants or number in reasons\n",
        _restarts_all,
    ),
    "told-of-arrived": Fault(
        "a recording that was cut off counts as whole",
        "capture_app/node/burst/burst_session.py",
        "        instants = self.burst.frames if is_ordered else self._recorded_instants\n",
        "        instants = self._recorded_instants\n",
        _restarts_all_at_end,
    ),
    "instant-twice": Fault(
        "an instant that a batch has twice is saved twice",
        "capture_app/session/writing/video_store.py",
        "                waiting |= {instant} - {NO_INSTANT}\n",
        "",
        lambda plan: TWICE in plan.liars.values() and _has("recording")(plan),
    ),
    "foreign-file": Fault(
        "a node follows a link in its spool, and deletes what is behind it",
        "capture_app/node/camera/spool.py",
        " and folder.is_dir() and not folder.is_symlink()",
        " and folder.is_dir() and all(file.unlink() is None for file in folder.iterdir())",
    ),
    "late": Fault(
        "a frame that is too early for its instant does not count as off it",
        "capture_app/session/format/manifest.py",
        "tolerance_ns is not None and abs(residual_ns) > tolerance_ns",
        "tolerance_ns is not None and residual_ns > tolerance_ns",
    ),
}
"""Faults by name."""


def fitting_seeds(fault: Fault, seeds: Iterator[int], tried: int = TRIED) -> Iterator[int]:
    """Yield the first `tried` of the seeds whose plans fit the fault."""
    return itertools.islice((seed for seed in seeds if fault.fits(draw(seed))), tried)
