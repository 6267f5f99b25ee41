"""Twenty folders of videos as strangers have them, and what an import of each must say.

Names are those that the apps give by their manuals: GoPro's GX/GH and chapter before the number, its cards'
DCIM/100GOPRO, iPhones' IMG_0042.MOV, Android's PXL_ and VID_ with a date, macOS's ._ files. Clips are cut at
known offsets that are no whole frames.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_app.common.names import name_like
from tests.importers.test_layouts import CAMERA
from tests.session.alignment.cut_apart import Phone, Take

CLAPS = Take(claps_s=(2.2, 3.31, 4.17))
FLASH, LAMP = Take(flashes_s=(3.1,)), Take(lamp_s=(2.9,))
DAY = "2026-05-01T10:00:{:09.6f}Z"
A = Phone("a", exposure_s=0.02)
B = Phone("b", start_s=1.2345, ppm=20, exposure_s=0.02, seed=2)
C = Phone("c", start_s=0.517, fps=25, exposure_s=0.02, size=(96, 64), seed=3)


@dataclass(frozen=True)
class Folder:
    """What lies in it: by path, the phone that took it and what happened; other files; the answer."""

    clips: dict[str, tuple[Phone, Take]]
    others: dict[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = ()
    """Of each session's cameras; empty where nothing tells."""
    sessions: tuple[int, ...] = (2,)
    """How many cameras each session has."""
    said: str = ""
    sound: bool = True
    calibrated: bool = False

    def make(self, root: Path) -> None:
        """Render it."""
        for path, (phone, take) in self.clips.items():
            phone.record(take, root / path, 2 if path == "cat.mp4" else 6, sound=self.sound)
        for path, text in self.others.items():
            (root / path).write_text(text)


def dated(phone: Phone, second: float) -> Phone:
    return replace(phone, created=DAY.format(second))


TOML = "".join(CAMERA.format(n=n, x=0.2 * n).replace("64, 48", "64, 96") for n in range(2))
FOLDERS = {
    "two phones that heard a clap": Folder(
        {"left.mp4": (A, CLAPS), "right.mp4": (B, CLAPS)},
        sources=("sound",),
    ),
    "iphone and android, other rates and sizes": Folder(
        {"IMG_0042.MOV": (A, CLAPS), "PXL_20260501_100001123.mp4": (C, CLAPS)}, sources=("sound",)
    ),
    "names that are no names": Folder(
        {"My clip (1).mp4": (A, CLAPS), "My clip (2).mp4": (B, CLAPS)}, sources=("sound",)
    ),
    "one flash": Folder({"l.mp4": (A, FLASH), "r.mp4": (B, FLASH)}, sources=("flash",), sound=False),
    "a lamp": Folder({"l.mp4": (A, LAMP), "r.mp4": (B, LAMP)}, sources=("flash",), sound=False),
    "timecode": Folder(
        {
            "l.mov": (replace(A, timecode="10:00:00:00"), Take()),
            "r.mov": (replace(B, timecode="10:00:01:07"), Take()),
        },
        sources=("timecode",),
        sound=False,
    ),
    "timecodes of clocks that nobody set": Folder(
        {
            "GX010012.MP4": (replace(A, timecode="10:00:00:00"), CLAPS),
            "GX010031.MP4": (replace(B, timecode="04:11:09:03"), CLAPS),
        },
        sources=("sound",),
        said="not taken: others differ",
    ),
    "nothing tells": Folder(
        {"l.mp4": (A, Take()), "r.mp4": (B, Take())},
        sound=False,
        said="reconstruct time",
    ),
    "three, one of them deaf": Folder(
        {"a.mp4": (A, Take(CLAPS.claps_s, lamp_s=(2.9,))), "b.mp4": (B, CLAPS), "c.mp4": (C, CLAPS)},
        sources=("sound",),
        sessions=(3,),
    ),
    "stray files": Folder(
        {"l.mp4": (A, CLAPS), "r.mp4": (B, CLAPS)},
        others={
            ".DS_Store": "",
            "._l.mp4": "apple",
            "notes.txt": "shot 1",
            "broken.mp4": "nothing",
            "l.LRV": "",
        },
        sources=("sound",),
        said="left out broken.mp4: it cannot be decoded",
    ),
    "a stray clip of another day": Folder(
        {
            "l.mp4": (dated(A, 1), CLAPS),
            "r.mp4": (dated(B, 2), CLAPS),
            "cat.mp4": (replace(A, created="2025-12-24T18:00:00.000000Z"), Take()),
        },
        sources=("sound",),
        said="left out cat.mp4: of another date and another length",
    ),
    "a clock that is hours wrong": Folder(
        {"l.mp4": (dated(A, 1), CLAPS), "r.mp4": (replace(B, created="2016-01-01T00:03:00.000000Z"), CLAPS)},
        sources=("sound",),
    ),
    "a folder a camera": Folder(
        {"cam1/IMG_0001.MOV": (A, CLAPS), "cam2/IMG_0077.MOV": (B, CLAPS)}, sources=("sound",)
    ),
    "cards as they are": Folder(
        {"GoPro 1/DCIM/100GOPRO/GX010012.MP4": (A, CLAPS), "GoPro 2/DCIM/100GOPRO/GX010044.MP4": (B, CLAPS)},
        sources=("sound",),
    ),
    "one folder deeper": Folder(
        {"footage/l.mp4": (A, CLAPS), "footage/r.mp4": (B, CLAPS)},
        sources=("sound",),
    ),
    "takes by name": Folder(
        {f"cam{c}_take{t}.mp4": (phone, CLAPS) for t in (1, 2) for c, phone in ((1, A), (2, B))},
        sources=("sound",),
        sessions=(2, 2),
    ),
    "a folder a take": Folder(
        {f"take{t}/{c}.mp4": (phone, CLAPS) for t in (1, 2) for c, phone in (("left", A), ("right", B))},
        sources=("sound",),
        sessions=(2, 2),
    ),
    "takes by date": Folder(
        {
            "VID_20260501_1.mp4": (dated(A, 0), CLAPS),
            "IMG_0001.MOV": (dated(B, 1), CLAPS),
            "VID_20260501_2.mp4": (dated(A, 30), CLAPS),
            "IMG_0002.MOV": (dated(B, 31), CLAPS),
        },
        sources=("sound",),
        sessions=(2, 2),
    ),
    "a calibration beside": Folder(
        {"cam_0.mp4": (A, CLAPS), "cam_1.mp4": (B, CLAPS)},
        others={"calibration.toml": TOML},
        sources=("sound",),
        calibrated=True,
        said="reconstruct compare",
    ),
    "a calibration of other cameras": Folder(
        {"left.mp4": (A, CLAPS), "right.mp4": (B, CLAPS)},
        others={"calibration.toml": TOML},
        sources=("sound",),
        said="calibration.toml is not taken",
    ),
}


def phone_of(folder: Folder, camera: str) -> Phone:
    """The phone whose clips became a camera: by the file's name, its first word, or its folder's name."""
    for path, (phone, _) in folder.clips.items():
        stem = Path(path).stem
        if camera in {name_like(text, "") for text in (stem, stem.split("_")[0], Path(path).parts[0])}:
            return phone
    raise AssertionError(camera)


MIDDLE_NS = 2_500_000_000
"""The own time of a clip at which its offset is held against the truth."""


def true_offset_ms(folder: Folder, camera: str, reference: str) -> float:
    """What is added to a camera's own time there to get the reference's."""
    own, other = phone_of(folder, camera), phone_of(folder, reference)
    return float(other.own_s(own.true_s(MIDDLE_NS / 1e9))) * 1e3 - MIDDLE_NS / 1e6
