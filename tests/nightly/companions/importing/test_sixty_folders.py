"""Sixty folders with known offsets, half of them with timecodes, dates or names that mislead.

None may be aligned falsely; those with claps, flashes, or a lamp that a timecode confirms are aligned.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from tests.unit.companions.importing.strangers import MIDDLE_NS
from tests.unit.plugins.footage.cut_apart import Phone, Take

DAY = "2026-05-01T{:02d}:00:{:02d}.000000Z"


@dataclass(frozen=True)
class Folder:
    """Two phones at one take, what both recorded of it, and what misleads about their times."""

    evidence: str
    misled: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.evidence}, {self.misled or 'nothing misleads'}, {self.seed}"

    @property
    def late_s(self) -> float:
        return 0.4 + 0.2379 * self.seed

    def take(self) -> Take:
        at = tuple(2.9 + self.seed / 20 + step for step in (0.0, 0.71, 1.19, 1.97))
        return {
            "claps": Take(claps_s=at, seed=self.seed),
            "flashes": Take(flashes_s=at),
            "lamp": Take(lamp_s=at[:1]),
            "nothing": Take(),
        }[self.evidence]

    def phones(self) -> tuple[Phone, Phone]:
        """The second phone starts `late_s` after the first."""
        one, other = Phone("a", exposure_s=0.02), Phone("b", self.late_s, ppm=20, exposure_s=0.02, seed=2)
        codes, dates = {
            "": (("", ""), ("", "")),
            "timecodes of recorded time": (("00:00:00:00",) * 2, ("", "")),
            "an editor's timecodes": (("01:00:00:00",) * 2, ("", "")),
            "timecodes of clocks that nobody set": (("00:03:11:04", "00:03:11:20"), ("", "")),
            "timecodes and dates of such clocks": (
                ("10:00:05:00", "10:00:07:00"), (DAY.format(10, 5), DAY.format(10, 7)),
            ),
            "dates an hour apart": (("", ""), (DAY.format(10, 0), DAY.format(11, 0))),
        }[self.misled]  # fmt: skip
        return replace(one, timecode=codes[0], created=dates[0]), replace(
            other, timecode=codes[1], created=dates[1]
        )


MISLED = (
    "timecodes of recorded time",
    "an editor's timecodes",
    "timecodes of clocks that nobody set",
    "timecodes and dates of such clocks",
    "dates an hour apart",
)


def folders() -> Iterator[Folder]:
    for seed in range(8):
        for evidence in ("claps", "flashes", "lamp", "nothing"):
            yield Folder(evidence, "", seed)
    for seed, misled in enumerate(MISLED * 2):
        for evidence in ("claps", "flashes", "nothing"):
            yield Folder(evidence, misled, seed)


FOLDERS = list(folders())


def test_there_are_sixty() -> None:
    assert len(FOLDERS) >= 60
    assert sum(bool(folder.misled) for folder in FOLDERS) >= 30


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_folder_is_aligned_by_its_evidence_or_not_at_all(folder: Folder, tmp_path: Path) -> None:
    suffix = ".mov" if "timecode" in folder.misled else ".mp4"
    for phone in folder.phones():
        sound = folder.evidence == "claps"
        phone.record(folder.take(), tmp_path / "rec" / f"{phone.name}{suffix}", 6, sound=sound)
    (session,) = import_found([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(count=20))
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.unknown == (folder.evidence in ("lamp", "nothing"))
    for name, of in times.cameras.items():
        phones = {phone.name: phone for phone in folder.phones()}
        own, reference = phones[name], phones[times.reference]
        true_ms = float(reference.own_s(own.true_s(MIDDLE_NS / 1e9))) * 1e3
        bar_ms = (of.uncertainty_at_ns(MIDDLE_NS) or 0) / 1e6
        assert abs(of.leader_from_local(MIDDLE_NS) / 1e6 - true_ms) <= bar_ms + 1e-6 < 45
