"""Scores of people in 3D against true joints: who is who, what is missing, and whether stated errors hold."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.people.figure import Floats
from reconstruction.methods.people.assignment import assign
from reconstruction.methods.people.joint_positions import Person

SAME_M = 0.5
"""Largest median distance of joints, m, at which a located person is a true one."""


class Scores(NamedTuple):
    """Counts of one take; add them up over takes."""

    takes: int
    takes_right: int
    """Takes with as many individuals as in truth, each of them one true person."""
    individuals: int
    individuals_found: int
    person_frames: int
    changes: int
    """Times at which a true person has another number than before."""
    extra: int
    """Persons at a time who are nobody, or a second time somebody."""
    joints: int
    missing: int
    within: int
    errors_mm: tuple[Floats, ...]
    """Distances of all known joints from the truth."""

    def __add__(self, other: "Scores") -> "Scores":  # type: ignore[override]
        pairs: list[Any] = [*zip(self, other, strict=True)]
        return Scores(*(a + b for a, b in pairs))

    def figures(self) -> dict[str, float]:
        """Return the figures of a report, fractions from 0 to 1."""
        errors = np.concatenate([*self.errors_mm, np.full(1, np.nan)])
        frames, joints = max(self.person_frames, 1), max(self.joints, 1)
        return {
            "takes_right": self.takes_right / max(self.takes, 1),
            "true": self.individuals,
            "found": self.individuals_found,
            "changes": 1e3 * self.changes / frames,
            "extra": 1e3 * self.extra / frames,
            "missing": self.missing / joints,
            "within": self.within / max(self.joints - self.missing, 1),
            "median": float(np.nanmedian(errors)),
            "most": float(np.nanpercentile(errors, 90)),
        }


def score(truth: Floats, visible: NDArray[np.bool_], people: Sequence[Person]) -> Scores:
    """Compare people with true joints (people, times, joints, 3), m, NaN = absent.

    `visible` (people, times, joints) are the joints that at least two cameras show, which count as missing.
    """
    number, times = truth.shape[:2]
    last, owners = dict[int, int](), [set[int]() for _ in people]
    changes = extra = missing = within = present = 0
    errors = list[Floats]()
    for k in range(times):
        apart = np.full((number, len(people)), np.inf)
        for row in range(number):
            for column, person in enumerate(people):
                distances = np.linalg.norm(person.positions[k] - truth[row, k], axis=1)
                if np.isfinite(distances).any():
                    apart[row, column] = float(np.nanmedian(distances))
        pairs = dict(assign(apart, SAME_M))
        somebody = [k for person in people if np.isfinite(person.error[k]).any()]
        there = np.any(np.isfinite(truth[:, k]), axis=(1, 2))
        extra += len(somebody) - len(pairs)
        present += int((there & (visible[:, k].sum(axis=1) > 0)).sum())
        for row in np.flatnonzero(there).tolist():
            seen = visible[row, k] & np.isfinite(truth[row, k]).all(axis=1)
            if row not in pairs:
                missing += int(seen.sum())
                continue
            person = people[pairs[row]]
            changes += int(last.get(row, pairs[row]) != pairs[row])
            last[row] = pairs[row]
            owners[pairs[row]].add(row)
            distances = np.linalg.norm(person.positions[k] - truth[row, k], axis=1)
            known = seen & np.isfinite(distances)
            missing += int((seen & ~known).sum())
            within += int((distances[known] <= person.error[k][known]).sum())
            errors.append(distances[known] * 1e3)
    individuals = int((np.isfinite(truth).all(axis=3) & visible).any(axis=(1, 2)).sum())
    own = [next(iter(owner)) for owner in owners if len(owner) == 1]
    right = len(people) == individuals == len(own) == len(set(own))
    joints = int((visible & np.isfinite(truth).all(axis=3)).sum())
    return Scores(
        1, int(right), individuals, len(people), present, changes, extra, joints, missing, within,
        tuple(errors),
    )  # fmt: skip
