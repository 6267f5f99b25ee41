"""Each instant's own votes for an offset, and how the offset changes over a take: in steps, or at a rate.

A camera that drops a frame is a frame later from then on, in a recording that counts frames. Every instant
votes for offsets by its own crossings. Three explanations of all votes are compared: one offset, an offset
that changes by whole frames, and an offset that grows at a rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from msgspec import Struct, structs

from reconstruction.common.geometry import Array
from reconstruction.common.templates import render_sentences

BIN_MS = 0.5
"""Step between the offsets that are voted for."""
MATCH_PX = 0.5
"""Error of a match across its epipolar line."""
TOLERANCE_FRAMES = 0.15
"""Standard deviation of an instant's own offset about the common one, in frames."""
FAINT_VOTES = 4.0
"""Votes with which an instant counts half; more than one instant's worth of matches does not count more."""
CHANGE_COST = 1.2
"""Number of instants that must gain by a change of the offset."""
FRAME_COST = 0.5
"""The same by each further frame of one step. Two instants at the end may seem far off where motion turns."""
MIN_DRIFT_FRAMES = 0.6
"""Minimum change over the take, in frames; a wrong calibration may cause a smaller one."""
UNDECIDED, EQUAL = 0.7, 0.3
"""A step may be at the instants at which the score differs by less than the first, instants' worth of votes.

At those within the second, it is equally likely."""
MIN_VOTES = 6.0
"""Minimum number of crossings that must agree."""
DISTINCT = 1.6
"""Minimum ratio of agreeing crossings to those at any other offset; wrong matches vote for every offset."""
ELSEWHERE_FRAMES = 0.55
"""Distance from the common offset, in frames, from which an instant's own peak disagrees."""
GLITCH_FRAMES, GLITCH_VOTES = 0.3, 12.0
"""The same from which a single image is reported as a glitch, and the crossings that must agree on it."""
MAX_GLITCH_FRAMES = 1.25
"""Distance up to which it is: far from the offset, wrong matches agree more often."""
MAX_LAST_FRAMES = 2.5
"""The same up to which a first or last instant alone may be after dropped frames."""


class Step(Struct, frozen=True):
    """A change of the second camera's delay by whole frames, from an instant on.

    The camera dropped this number of frames before the instant, or repeated them if it is negative.
    """

    instant: int
    frames: int
    earliest: int
    latest: int
    """First and last instant from which the step may be in effect, by the images."""


class Change(Struct, frozen=True, omit_defaults=True):
    """How a camera's delay changes over a take; nothing if it does not change."""

    steps: tuple[Step, ...] = ()
    """Relative to the delay at the first instant."""
    drift: float = 0.0
    """Growth of the delay in a second."""
    drift_sd: float = 0.0
    pivot: float = 0.0
    """Instant at which the drift is zero: the middle of the take."""

    def at_ms(self, instants: Array, period_ms: float) -> Array:
        """Return the change of the delay at instants (n,), ms."""
        frames = self.drift * (instants - self.pivot)
        for step in self.steps:
            frames = frames + step.frames * (instants >= step.instant)
        return np.asarray(frames * period_ms)

    def reversed(self) -> "Change":
        """Return the change of the first camera's delay relative to the second's."""
        steps = tuple(structs.replace(step, frames=-step.frames) for step in self.steps)
        return structs.replace(self, steps=steps, drift=-self.drift)

    def followed_by(self, other: "Change") -> "Change":
        """Return the sum of two changes; steps that may be at one instant are one."""
        steps: list[Step] = []
        for step in sorted(self.steps + other.steps, key=lambda one: one.instant):
            if steps and step.earliest - 1 <= steps[-1].latest:
                last = steps.pop()
                low, high = max(last.earliest, step.earliest), min(last.latest, step.latest)
                step = Step(
                    round((last.instant + step.instant) / 2),
                    last.frames + step.frames,
                    min(low, high),
                    max(low, high),
                )
            steps.append(step)
        return Change(
            steps=tuple(step for step in steps if step.frames),
            drift=self.drift + other.drift,
            drift_sd=float(np.hypot(self.drift_sd, other.drift_sd)),
            pivot=self.pivot or other.pivot,
        )

    def witnessed(self, instants: Sequence[int]) -> bool:
        """Return whether instants with an offset of their own are before, between and after the steps.

        Votes of wrong matches may prefer a step where nothing is measured after it.
        """
        sides = np.searchsorted([step.instant for step in self.steps], instants, side="right")
        return not self.steps or len(np.unique(sides)) == len(self.steps) + 1

    def resembles(self, other: "Change") -> bool:
        """Return whether both are the same steps, at instants that may be the same, or drifts of one sign."""
        return (
            len(self.steps) == len(other.steps)
            and np.sign(self.drift) == np.sign(other.drift)
            and all(
                a.frames == b.frames and a.earliest <= b.latest and b.earliest <= a.latest
                for a, b in zip(self.steps, other.steps, strict=True)
            )
        )

    def __bool__(self) -> bool:
        """Whether the delay changes."""
        return bool(self.steps) or self.drift != 0.0

    def describe(self, camera: str, than: str) -> str:
        """Return the change in words: `R is one frame later than L from instant 20 on`; empty if none."""
        return render_sentences("change.txt", __package__, change=self, camera=camera, than=than)


UNCHANGED = Change()


@dataclass(frozen=True)
class Votes:
    """Votes (t, g) of each of the instants (t,), in order, for each offset (g,) ms."""

    instants: Array
    offsets_ms: Array
    votes: Array

    def apart_ms(
        self, offset_ms: float, period_ms: float, min_frames: float, min_votes: float = MIN_VOTES
    ) -> dict[int, float]:
        """Return the instants with a clear peak this far from an offset, each with its delay beyond it."""
        apart = np.abs(self.offsets_ms - offset_ms) / period_ms
        best, here = self.votes.max(1), np.where(apart < min_frames, self.votes, 0.0).max(1)
        odd = np.flatnonzero((best >= min_votes) & (here * 2 * DISTINCT < best))
        own_ms = self.offsets_ms[self.votes.argmax(1)] - offset_ms
        return {int(self.instants[k]): float(own_ms[k]) for k in odd}

    def disagreeing(self, offset_ms: float, period_ms: float) -> tuple[int, ...]:
        """Return the instants of runs that have a clear peak of their own elsewhere.

        A run has two instants of about the same peak; one is enough if it is the first or the last of all
        that have a clear peak. A single one between others may be a wrong match.
        """
        odd = self.apart_ms(offset_ms, period_ms, ELSEWHERE_FRAMES)
        clear = [int(k) for k in self.instants[self.votes.max(1) >= MIN_VOTES]]
        jumps = {k for k in odd if k in (clear[0], clear[-1]) and abs(odd[k]) < MAX_LAST_FRAMES * period_ms}
        for k, other in pairwise(clear):
            if k in odd and other in odd and abs(odd[other] - odd[k]) < period_ms / 2:
                jumps |= {k, other}
        return tuple(sorted(jumps))


def count_votes(instant: Array, offset_ms: Array, across_px_per_ms: Array, counts: Array) -> Votes:
    """Count the votes of crossings (n,), each a bell of the width of its error; see `Crossings`."""
    instants, place = np.unique(instant, return_inverse=True)
    max_abs_ms = float(np.abs(offset_ms).max(initial=0.0)) + 1
    grid = np.arange(-max_abs_ms, max_abs_ms, BIN_MS)
    widths = np.maximum(MATCH_PX / np.abs(across_px_per_ms), BIN_MS)
    votes = np.zeros((len(instants), len(grid)))
    for row, at, width, count in zip(place, offset_ms, widths, counts, strict=True):
        begin, end = np.searchsorted(grid, (at - 4 * width, at + 4 * width))
        votes[row, begin:end] += count * np.exp(-0.5 * ((grid[begin:end] - at) / width) ** 2)
    return Votes(instants, grid, votes)


def find_change(votes: Votes, period_ms: float) -> Change:
    """Return the change of the offset that explains the instants' votes best, if one offset does not."""
    support = _support(votes, period_ms)
    stepped, steps = _best_steps(votes, support, period_ms)
    sloped, drift = _best_drift(votes, support, period_ms)
    if stepped >= sloped - CHANGE_COST:
        return Change(steps=steps)
    return Change(drift=drift, pivot=float(np.mean(votes.instants[[0, -1]])))


def _support(votes: Votes, period_ms: float) -> Array:
    """Return how well each offset agrees with each instant, (t, g): 1 at the peak of many votes."""
    sd_bins = TOLERANCE_FRAMES * period_ms / BIN_MS
    size = votes.votes.shape[1]
    # Farther than the whole grid nothing can be near, whatever period a session states.
    reach = min(round(3 * sd_bins), size)
    near = range(-reach, reach + 1)
    whole = np.pad(votes.votes, ((0, 0), (len(near), len(near))))
    best = np.zeros_like(votes.votes)
    for bins in near:
        moved = whole[:, len(near) + bins :][:, :size]
        np.maximum(best, np.exp(-0.5 * (bins / sd_bins) ** 2) * moved, out=best)
    return np.asarray(best / (votes.votes.max(1, keepdims=True) + FAINT_VOTES))


def _best_steps(votes: Votes, support: Array, period_ms: float) -> tuple[float, tuple[Step, ...]]:
    """Return the best score of an offset that changes by whole frames, and the changes.

    By dynamic programming over the instants (Bellman 1957), with a cost for each change by its frames.
    """
    # Steps of at most four frames are searched for.
    frames = np.arange(-4, 4 + 1)
    bins = np.rint(frames * period_ms / BIN_MS).astype(int)
    costs = (CHANGE_COST + FRAME_COST * (np.abs(frames) - 1)) * (frames != 0)
    times, size = support.shape
    score, came = support[0], np.zeros(support.shape, int)
    source = np.arange(size) - bins[:, None]
    there = (source >= 0) & (source < size)
    source = source.clip(0, size - 1)
    for k in range(1, times):
        before = np.where(there, score[source] - costs[:, None], -np.inf)
        came[k] = before.argmax(0)
        score = before.max(0) + support[k]
    at = int(score.argmax())
    path, best = [at], float(score[at])
    for k in range(times - 1, 0, -1):
        path.append(path[-1] - int(bins[came[k, path[-1]]]))
    path = path[::-1]
    changes = [k for k in range(1, times) if path[k] != path[k - 1]]
    return best, tuple(
        _place_step(votes, support, (path[k - 1], path[k]), (begin, end), period_ms)
        for begin, k, end in zip([0, *changes], changes, [*changes[1:], times], strict=False)
    )


def _place_step(
    votes: Votes, support: Array, offsets: tuple[int, int], between: tuple[int, int], period_ms: float
) -> Step:
    """Return a step between two offsets, by the votes between the changes before and after it.

    The image before a gap fits both delays, or the image before a repeated one.
    """
    (old, new), (begin, end) = offsets, between
    scores = np.cumsum(support[begin:end, old] - support[begin:end, new])[:-1]
    possible, likely = (
        begin + 1 + np.flatnonzero(scores >= scores.max() - less)[[0, -1]] for less in (UNDECIDED, EQUAL)
    )
    frames = round((new - old) * BIN_MS / period_ms)
    chosen = likely.mean() if np.ptp(likely) > 1 else likely[0 if frames > 0 else 1]
    # Instants without votes may be on either side.
    earliest, latest = votes.instants[possible[0] - 1] + 1, votes.instants[possible[1]]
    return Step(int(votes.instants[int(chosen)]), frames, int(earliest), int(latest))


def _best_drift(votes: Votes, support: Array, period_ms: float) -> tuple[float, float]:
    """Return the best score of an offset that grows with time, and its growth in frames per instant."""
    since = votes.instants - votes.instants.mean().round()
    span = int(votes.instants[-1] - votes.instants[0])
    # Frame rates that differ by at most 35 % are searched for.
    max_frames = min(0.35 * span, float(votes.offsets_ms[-1]) / period_ms)
    rows, size = np.arange(len(since))[:, None], support.shape[1]
    whole = np.pad(support, ((0, 0), (size, size)))
    best = 0.0, 0.0
    for frames in np.arange(MIN_DRIFT_FRAMES, max_frames, 0.1):
        for drift in (frames / span, -frames / span):
            bins = np.rint(drift * period_ms * since / BIN_MS).astype(int)
            score = whole[rows, size + bins[:, None] + np.arange(size)].sum(0).max()
            best = max(best, (float(score), float(drift)))
    return best
