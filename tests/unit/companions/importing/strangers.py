"""Thirty folders of recordings as strangers have them, and what an import of each must say.

Names are those that the apps give by their manuals: GoPro's GX/GH and chapter before the number, its cards'
DCIM/100GOPRO, iPhones' IMG_0042.MOV, Android's PXL_ and VID_ with a date, macOS's ._ files. Clips are cut at
known offsets that are no whole frames.
"""

import struct
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import av
import numpy as np

from capture_app.common.names import name_like
from tests.unit.plugins.footage.cut_apart import SOUND_HZ, Phone, Take
from tests.unit.plugins.programs.test_layouts import CAMERA
from tests.unit.session.conftest import jpeg

CLAPS = Take(claps_s=(2.2, 3.31, 4.17))
FLASHES = Take(flashes_s=(2.1, 2.73, 3.1, 4.02))
FLASH, LAMP = Take(flashes_s=(3.1,)), Take(lamp_s=(2.9,))
DAY = "2026-05-01T10:00:{:09.6f}Z"
A = Phone("a", exposure_s=0.02)
B = Phone("b", start_s=1.2345, ppm=20, exposure_s=0.02, seed=2)
C = Phone("c", start_s=0.517, fps=25, exposure_s=0.02, size=(96, 64), seed=3)


@dataclass(frozen=True)
class Folder:
    """What is in it: by path, the phone that took it and what happened; other files; the answer."""

    clips: dict[str, tuple[Phone, Take]]
    others: dict[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = ()
    """Of each session's cameras; empty where nothing tells."""
    sessions: tuple[int, ...] = (2,)
    """How many cameras each session has."""
    said: str = ""
    sound: bool = True
    calibrated: bool = False
    mute: tuple[str, ...] = ()
    """Clips without a track of sound, by path."""
    upside_down: tuple[str, ...] = ()
    """Clips whose header has players turn them by 180 degrees, by path."""
    images: tuple[str, ...] = ()
    recorder: str = ""
    """A sound recorder's file of the same claps."""
    packed: bool = False
    """Everything is in a zip archive beside the folder, which is what is imported."""

    @property
    def refused(self) -> bool:
        """Whether nothing of it can become a session."""
        return self.sessions == ()

    def make(self, root: Path) -> Path:
        """Render it, and return the path that a user would import."""
        root.mkdir()
        for path, (phone, take) in self.clips.items():
            sound = self.sound and path not in self.mute
            phone.record(take, root / path, 2 if path == "cat.mp4" else 6, sound=sound)
        for path, text in self.others.items():
            (root / path).write_text(text)
        for number, path in enumerate(self.images):
            (root / path).parent.mkdir(exist_ok=True)
            (root / path).write_bytes(jpeg(number))
        for path in self.upside_down:
            turn_upside_down(root / path)
        if self.recorder:
            record_sound(CLAPS, root / self.recorder)
        if not self.packed:
            return root
        archive = root.with_suffix(".zip")
        with zipfile.ZipFile(archive, "w") as packed:
            for file in sorted(root.rglob("*.*")):
                packed.write(file, file.relative_to(root))
        return archive


def turn_upside_down(path: Path) -> None:
    """Write a rotation by 180 degrees into the first track's header (ISO 14496-12, tkhd's matrix)."""
    data = path.read_bytes()
    matrix = data.index(b"tkhd") + 4 + 40
    assert data[matrix : matrix + 4] == struct.pack(">i", 1 << 16)
    turned = struct.pack(">9i", -1 << 16, 0, 0, 0, -1 << 16, 0, 0, 0, 1 << 30)
    path.write_bytes(data[:matrix] + turned + data[matrix + 36 :])


def record_sound(take: Take, path: Path) -> None:
    """Write six seconds of a sound recorder's WAV file."""
    with av.open(str(path), "w") as container:
        track = container.add_stream("pcm_s16le", rate=SOUND_HZ, layout="mono")
        heard = take.sound(np.arange(6 * SOUND_HZ) / SOUND_HZ)
        samples = np.clip(heard * 20_000, -32_768, 32_767).astype(np.int16)[None]
        spoken = av.AudioFrame.from_ndarray(samples, format="s16", layout="mono")
        spoken.sample_rate = SOUND_HZ
        container.mux(track.encode(spoken))
        container.mux(track.encode(None))


def next_chapter(phone: Phone) -> Phone:
    """The camera that goes on after its first six seconds, as a GoPro does in another file."""
    return replace(phone, start_s=float(phone.true_s(6.0)))


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
    "flashes": Folder({"l.mp4": (A, FLASHES), "r.mp4": (B, FLASHES)}, sources=("flash",), sound=False),
    "one flash": Folder(
        {"l.mp4": (A, FLASH), "r.mp4": (B, FLASH)}, sound=False, said="if it is right: --align flash"
    ),
    "a lamp": Folder(
        {"l.mp4": (A, LAMP), "r.mp4": (B, LAMP)}, sound=False, said="if it is right: --align flash"
    ),
    "a lamp, and a timecode that agrees": Folder(
        {
            "l.mov": (replace(A, timecode="10:00:00:00"), LAMP),
            "r.mov": (replace(B, timecode="10:00:01:07"), LAMP),
        },
        sources=("flash",),
        sound=False,
    ),
    "a lamp, and a timecode that disagrees": Folder(
        {
            "l.mov": (replace(A, timecode="10:00:00:00"), LAMP),
            "r.mov": (replace(B, timecode="10:00:02:07"), LAMP),
        },
        sound=False,
        said="which nothing confirms",
    ),
    "timecode": Folder(
        {
            "l.mov": (replace(A, timecode="10:00:00:00"), Take()),
            "r.mov": (replace(B, timecode="10:00:01:07"), Take()),
        },
        sound=False,
        said="if it is right: --align timecode",
    ),
    "timecodes of recorded time": Folder(
        {f"{name}.mov": (replace(of, timecode="00:00:00:00"), Take()) for name, of in (("l", A), ("r", B))},
        sound=False,
        said="both timecodes begin at 00:00:00:00",
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
        said="c lacks 24 images: no frame within half a period (instants 2, 8,",
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
    "two chapters of three cameras": Folder(
        {
            f"GoPro {n}/DCIM/100GOPRO/GX0{chapter}00{n}1.MP4": (
                next_chapter(phone) if chapter == 2 else phone,
                CLAPS,
            )
            for n, phone in ((1, A), (2, B), (3, C))
            for chapter in (1, 2)
        },
        sources=("sound",),
        sessions=(3,),
        said="goes on in GX020011.MP4",
    ),
    "one of three is mute": Folder(
        {"a.mp4": (A, CLAPS), "b.mp4": (B, CLAPS), "c.mp4": (C, CLAPS)},
        mute=("c.mp4",),
        sources=("sound",),
        said="left out c: it cannot be aligned",
    ),
    "one upside down": Folder(
        {"left.mp4": (A, CLAPS), "right.mp4": (B, CLAPS)},
        upside_down=("right.mp4",),
        sources=("sound",),
    ),
    "a zip": Folder(
        {"left.mp4": (A, Take()), "right.mp4": (B, Take())}, packed=True, sessions=(), said="is an archive"
    ),
    "a variable frame rate beside a constant one": Folder(
        {"phone.mp4": (replace(A, jitter_s=0.012), CLAPS), "camera.mp4": (B, CLAPS)}, sources=("sound",)
    ),
    "shoots of two days": Folder(
        {
            f"{day}_{name}.mp4": (replace(phone, created=f"2026-05-0{day}T10:00:0{k}.000000Z"), CLAPS)
            for day in (1, 2)
            for k, (name, phone) in enumerate((("left", A), ("right", B)))
        },
        sources=("sound",),
        sessions=(2, 2),
    ),
    "a sound recorder beside two phones": Folder(
        {"left.mp4": (A, CLAPS), "right.mp4": (B, CLAPS)}, recorder="ZOOM0001.WAV", sources=("sound",)
    ),
    "a folder of images a camera": Folder(
        {},
        images=tuple(f"{side}/{n:04}.jpg" for side in ("left", "right") for n in range(5)),
        sound=False,
        sessions=(),
        said="images of left, right have no times (add their rate, --fps",
    ),
    "images of two cameras in one folder": Folder(
        {},
        images=tuple(f"{side}_{n:04}.jpg" for side in ("L", "R") for n in range(5)),
        sound=False,
        sessions=(),
        said="images of L, R have no times (add their rate, --fps",
    ),
    "nothing that was filmed": Folder({}, others={"notes.txt": "shot 1"}, sessions=(), said="no "),
}


def phone_of(folder: Folder, camera: str) -> Phone:
    """The phone whose clips became a camera: by the file's name, its first or last word, or its folder's."""
    for path, (phone, _) in folder.clips.items():
        stem, words = Path(path).stem, Path(path).stem.split("_")
        if camera in {name_like(text, "") for text in (stem, words[0], words[-1], Path(path).parts[0])}:
            return phone
    raise AssertionError(camera)


MIDDLE_NS = 2_500_000_000
"""The own time of a clip at which its offset is held against the truth."""


def true_offset_ms(folder: Folder, camera: str, reference: str) -> float:
    """What is added to a camera's own time there to get the reference's."""
    own, other = phone_of(folder, camera), phone_of(folder, reference)
    return float(other.own_s(own.true_s(MIDDLE_NS / 1e9))) * 1e3 - MIDDLE_NS / 1e6
