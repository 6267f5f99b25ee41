"""Folders of recordings as people bring them, drawn from a seed, each with its truth in its pictures.

A folder is roles x scripts x instants x gaps x tables: which words of a path name the camera, the take, the
part and the instant. Each frame shows which camera took it at which instant, in blocks that survive JPEG and
video. So what an import paired is read from the stored pixels, not from names.

`KINDS` has a function for each kind of folder, with the page that documents it where there is one.
"""

import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

BLOCK_PX, COLUMNS, ROWS = 8, 8, 6
WIDTH_PX, HEIGHT_PX = COLUMNS * BLOCK_PX, ROWS * BLOCK_PX
DARK, LIGHT = 50, 205
_BITS = COLUMNS * ROWS // 2
"""Half of the blocks show a frame's number, half its complement: all frames are equally bright."""
BOARD_TAKE = 15
"""Take of films of a calibration board, which are no recording."""
MORNING = datetime(2024, 6, 15, 9, 30, tzinfo=UTC)


class Shot(NamedTuple):
    """Identity of a frame: equal `take` and `instant` are one moment."""

    camera: int
    instant: int
    take: int = 0


@dataclass(frozen=True)
class Picture:
    """An image file; without a `shot` it is of no camera, such as a thumbnail."""

    path: str
    shot: Shot | None


@dataclass(frozen=True)
class Film:
    """A video file of the frames `shots` at `fps`, begun at `begun` by its metadata."""

    path: str
    shots: tuple[Shot, ...]
    fps: int = 10
    begun: datetime | None = None


@dataclass(frozen=True)
class Folder:
    """A drawn folder: its files, and what its owner knows of it."""

    names: tuple[tuple[str, ...], ...]
    """Names of each camera that its owner would accept, the first as he writes it."""
    pictures: tuple[Picture, ...] = ()
    films: tuple[Film, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    """Contents of further files, by path."""
    answers: Mapping[str, str] = field(default_factory=dict)
    """Import options that are true of this folder, with their values: the owner's answers to questions."""
    right: str = ""
    """What a right import does, for people."""
    unclear: bool = False
    """Whether a person could not tell either: only a pair of different instants without doubt is a fault."""
    unpaired: bool = False
    """Whether nothing in the folder says which frames are one instant: an import has to state its doubt."""
    is_one_camera: bool = False
    """Whether one camera took everything: a refusal, or a session of this camera alone, is right."""
    kind: str = ""
    source: str = ""
    script: str = "ascii"

    @property
    def shots(self) -> frozenset[Shot]:
        """All identities that the files show."""
        shown = {picture.shot for picture in self.pictures if picture.shot}
        return frozenset(shown.union(*(film.shots for film in self.films)))

    @property
    def paths(self) -> list[str]:
        """Paths of all files, sorted."""
        return sorted([p.path for p in self.pictures] + [f.path for f in self.films] + list(self.texts))


def draw_shot(shot: Shot) -> Image:
    """Return the picture (48x64x3, uint8) that shows an identity."""
    number = (shot.camera << 16) | (shot.take << 12) | shot.instant
    bits = [(number >> place) & 1 for place in range(_BITS)]
    cells = np.array(bits + [1 - bit for bit in bits], np.uint8).reshape(ROWS, COLUMNS)
    grey = np.where(cells, LIGHT, DARK).astype(np.uint8)
    large = np.kron(grey, np.ones((BLOCK_PX, BLOCK_PX), np.uint8))
    return np.repeat(large[:, :, None], 3, axis=2)


def read_shot(image: Image) -> Shot | None:
    """Return the identity that a stored picture shows, or None if it shows none."""
    if image.shape[:2] != (HEIGHT_PX, WIDTH_PX):
        return None
    grey = image.mean(axis=2) if image.ndim == 3 else image.astype(float)
    cells = grey.reshape(ROWS, BLOCK_PX, COLUMNS, BLOCK_PX)[:, 2:-2, :, 2:-2].mean(axis=(1, 3)).ravel()
    bits = cells > (LIGHT + DARK) / 2
    if np.any(bits[:_BITS] == bits[_BITS:]):
        return None
    number = sum(int(bit) << place for place, bit in enumerate(bits[:_BITS]))
    return Shot(number >> 16, number & 0xFFF, (number >> 12) & 0xF)


def write_folder(folder: Folder, root: Path) -> None:
    """Write a drawn folder's files below `root`."""
    for picture in folder.pictures:
        path = _make(root, picture.path)
        image = draw_shot(picture.shot) if picture.shot else np.full((12, 16, 3), 128, np.uint8)
        path.write_bytes(cv2.imencode(path.suffix.lower(), image)[1].tobytes())
    for film in folder.films:
        _write_film(_make(root, film.path), film)
    for name, text in folder.texts.items():
        _make(root, name).write_text(text, encoding="utf-8")


def _make(root: Path, name: str) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write_film(path: Path, film: Film) -> None:
    import av  # slow to import, and folders of images do without

    form = {".mkv": "matroska", ".mov": "mov", ".avi": "avi"}.get(path.suffix.lower(), "mp4")
    with av.open(str(path), "w", format=form) as container:
        if film.begun:
            container.metadata["creation_time"] = f"{film.begun:%Y-%m-%dT%H:%M:%S}.000000Z"
        stream = container.add_stream("mpeg4", rate=film.fps)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        stream.bit_rate = 4_000_000
        for shot in film.shots:
            frame = av.VideoFrame.from_ndarray(draw_shot(shot), format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


# The roles' words.

_SCRIPTS: Mapping[str, Sequence[Sequence[str]]] = {
    "ascii": (
        ("left", "right"),
        ("front", "back", "side"),
        ("cam1", "cam2", "cam3"),
        ("camA", "camB"),
        ("c0", "c1", "c2", "c3"),
        ("GoPro", "iPhone"),
        ("L", "R"),
        ("master", "slave"),
        ("north", "east", "south", "west"),
    ),
    "umlauts": (("Böhm", "Müller"), ("Größe", "Höhe"), ("links", "rückwärts")),
    "umlauts NFD": (("Böhm", "Müller"), ("über", "unter")),
    "Japanese": (("カメラ左", "カメラ右"), ("正面", "側面", "背面")),
    "Cyrillic": (("левая", "правая"), ("Камера1", "Камера2")),
    "Arabic": (("يسار", "يمين"), ("كاميرا١", "كاميرا٢")),
    "spaces": (("Camera 1", "Camera 2", "Camera 3"), ("front left", "front right")),
    "emoji": (("📷a", "📷b"), ("🔴", "🔵")),
}


def _draw_names(rng: Random, *, plain: bool = False) -> tuple[str, list[str]]:
    """Return a script, and names of cameras in it; half are ASCII."""
    script = "ascii" if plain or rng.random() < 0.5 else rng.choice(list(_SCRIPTS))
    names = list(rng.choice(_SCRIPTS[script]))
    return script, [unicodedata.normalize("NFD" if script.endswith("NFD") else "NFC", one) for one in names]


def _draw_numbers(rng: Random, *, fewest: int = 1) -> list[str]:
    """Return the words of the instants: from 0, 1 or 1000, padded or not, some with a gap for all cameras."""
    count = rng.choice([n for n in (1, 2, 3, 6, 12, 40) if n >= fewest])
    first, width = rng.choice((0, 1, 1, 1000)), rng.choice((0, 3, 4, 6))
    numbers = list(range(first, first + count))
    if count > 3 and rng.random() < 0.3:
        del numbers[rng.randrange(1, count - 1)]
    return [f"{number:0{width}d}" for number in numbers]


def _lose(rng: Random, pictures: Sequence[Picture]) -> tuple[Picture, ...]:
    """Return the pictures, in a third of draws without the first or a middle one of one camera."""
    shots = [picture.shot for picture in pictures if picture.shot]
    instants = sorted({shot.instant for shot in shots if not shot.take})
    if len(instants) < 4 or rng.random() > 1 / 3:
        return tuple(pictures)
    lost = Shot(max(shot.camera for shot in shots), rng.choice((instants[0], instants[len(instants) // 2])))
    return tuple(picture for picture in pictures if picture.shot != lost)


def _grid(cameras: int, instants: int, path: Callable[[int, int], str], take: int = 0) -> list[Picture]:
    return [Picture(path(c, i), Shot(c, i, take)) for c in range(cameras) for i in range(instants)]


def _take_grids(
    form: str, takes: Sequence[str], names: Sequence[str], numbers: Sequence[str]
) -> list[Picture]:
    """Return the pictures of all takes; a path is the form with take, camera and number as t, c and n."""
    return [
        Picture(form.format(t=take, c=name, n=number), Shot(c, i, t))
        for t, take in enumerate(takes)
        for c, name in enumerate(names)
        for i, number in enumerate(numbers)
    ]


def _own(names: Iterable[str], *others: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    return tuple(zip(names, *others, strict=True))


def _litter(rng: Random) -> dict[str, str]:
    every = {".DS_Store": "Bud1", "Thumbs.db": "", "README.txt": "shot in the lab\n", "desktop.ini": "[x]\n"}
    return {name: text for name, text in every.items() if rng.random() < 0.15}


_NUMBERED = {"fps": "30"}
"""The owner's answer where equal numbers are one instant."""
Draw = Callable[[Random], Folder]
KINDS: dict[str, tuple[Draw, str]] = {}


def _kind(name: str, source: str = "") -> Callable[[Draw], Draw]:
    def add(draw: Draw) -> Draw:
        KINDS[name] = (draw, source)
        return draw

    return add


def draw_folders(seed: int, count: int, kinds: Sequence[str] = ()) -> list[Folder]:
    """Return `count` folders drawn from a seed, the kinds in turn (all of them, or those named)."""
    chosen = list(kinds or KINDS)
    return [_draw(seed, index, chosen[index % len(chosen)]) for index in range(count)]


def _draw(seed: int, index: int, kind: str) -> Folder:
    draw, source = KINDS[kind]
    folder = draw(Random(f"{seed}:{index}:{kind}"))
    return replace(folder, kind=kind, source=source)


# Images: the camera in a folder, before the number, behind it.


@_kind("images: a folder a camera")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    numbers, prefix = _draw_numbers(rng), rng.choice(("", "frame_", "img", "IMG_", "image-"))
    inner, ext = rng.choice(("", "", "images/", "data/", "rgb/")), rng.choice(("jpg", "png", "JPG", "tiff"))
    pictures = _grid(len(names), len(numbers), lambda c, i: f"{names[c]}/{inner}{prefix}{numbers[i]}.{ext}")
    return Folder(
        _own(names),
        _lose(rng, pictures),
        texts=_litter(rng),
        answers=_NUMBERED,
        right="each folder is a camera, equal numbers are one instant",
        script=script,
    )


@_kind("images: camera before the number")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    numbers, sep, ext = (
        _draw_numbers(rng),
        rng.choice(("_", "-", ".", " ")),
        rng.choice(("jpg", "png", "tif")),
    )
    middle = rng.choice(("", "", f"frame{sep}", f"img{sep}"))
    pictures = _grid(len(names), len(numbers), lambda c, i: f"{names[c]}{sep}{middle}{numbers[i]}.{ext}")
    return Folder(
        _own(names),
        _lose(rng, pictures),
        texts=_litter(rng),
        answers=_NUMBERED,
        right="the word before the number is the camera, equal numbers are one instant",
        script=script,
    )


@_kind("images: camera behind the number")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    numbers, sep, ext = _draw_numbers(rng), rng.choice(("_", "-", ".", " ")), rng.choice(("jpg", "png"))
    prefix = rng.choice(("", "frame", "scan_", "IMG_"))
    pictures = _grid(len(names), len(numbers), lambda c, i: f"{prefix}{numbers[i]}{sep}{names[c]}.{ext}")
    return Folder(
        _own(names),
        _lose(rng, pictures),
        texts=_litter(rng),
        answers=_NUMBERED,
        right="the word behind the number is the camera, equal numbers are one instant",
        script=script,
    )


@_kind("images: take, camera and number in a name")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    takes, numbers = (
        rng.choice((("walk",), ("walk", "run"), ("take1", "take2"))),
        _draw_numbers(rng, fewest=3),
    )
    form = rng.choice(("{t}_{c}_{n}.jpg", "{c}_{t}_{n}.jpg", "{t}-{c}-{n}.png"))
    return Folder(
        _own(names),
        tuple(_take_grids(form, takes, names, numbers)),
        answers=_NUMBERED,
        right=f"takes {', '.join(takes)}, each of all cameras",
        script=script,
    )


@_kind("images: nested folders of takes and cameras")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    takes, numbers = (
        rng.choice((("walk", "run"), ("take1", "take2"), ("01", "02"))),
        _draw_numbers(rng, fewest=3),
    )
    form = rng.choice(
        ("{t}/{c}/{n}.jpg", "{c}/{t}/{n}.jpg", "{t}/{c}/{n}.png", "session/{t}/{c}/frame_{n}.png")
    )
    return Folder(
        _own(names),
        tuple(_take_grids(form, takes, names, numbers)),
        answers=_NUMBERED,
        right=f"takes {', '.join(takes)}, each of all cameras",
        script=script,
    )


@_kind("images: case twins")
def _(rng: Random) -> Folder:
    names = list(rng.choice((("a", "A"), ("Cam1", "cam1"), ("Left", "left"))))
    numbers = _draw_numbers(rng, fewest=2)
    form = rng.choice(("{c}/{n}.jpg", "{c}/frame_{n}.png"))
    pictures = _grid(len(names), len(numbers), lambda c, i: form.format(c=names[c], n=numbers[i]))
    return Folder(_own(names), tuple(pictures), answers=_NUMBERED, right="two cameras, told apart by case")


# One instant of many cameras: photogrammetry rigs and stereo pairs.


@_kind("one instant: a picture a camera")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    prefix, ext = rng.choice(("", "", "scan_", "head-")), rng.choice(("jpg", "png", "JPG"))
    pictures = _grid(len(names), 1, lambda c, i: f"{prefix}{names[c]}.{ext}")
    return Folder(
        _own(names),
        tuple(pictures),
        texts=_litter(rng),
        answers=_NUMBERED,
        right="one picture a camera, one instant",
        script=script,
    )


@_kind("one instant: numbered cameras of a rig", "https://github.com/zju3dv/EasyMocap, one picture a camera")
def _(rng: Random) -> Folder:
    count = rng.choice((4, 8, 11, 24))
    form = rng.choice(("cam{:02d}.jpg", "cam{}.png", "camera_{:03d}.jpg", "pi{:02d}.jpg", "view{:02d}.png"))
    first = rng.choice((0, 1))
    words = [form.format(first + c) for c in range(count)]
    names = [word.rpartition(".")[0] for word in words]
    return Folder(
        _own(names),
        tuple(_grid(count, 1, lambda c, i: words[c])),
        answers=_NUMBERED,
        right=f"{count} cameras, one instant",
    )


@_kind("one instant: letter or device and a constant number")
def _(rng: Random) -> Folder:
    ring = rng.random() < 0.5
    count = 11 if ring else rng.choice((2, 4))
    names = [f"{c + 1:03d}" for c in range(count)] if ring else [chr(ord("A") + c) for c in range(count)]
    form = (
        rng.choice(("{}_0001_00001.jpg", "{}_0007_00001.jpg"))
        if ring
        else rng.choice(("{}_001.jpg", "{}001.jpg"))
    )
    return Folder(
        _own(names),
        tuple(_grid(count, 1, lambda c, i: form.format(names[c]))),
        answers=_NUMBERED,
        right=f"{count} cameras, one instant: only the first word changes",
    )


@_kind("stereo pairs: the first and second image", "https://vision.middlebury.edu/stereo/data/scenes2014/")
def _(rng: Random) -> Folder:
    pair = rng.choice((("im0", "im1"), ("view1", "view5"), ("img_left", "img_right"), ("left", "right")))
    ext = rng.choice(("png", "jpg"))
    return Folder(
        _own(pair),
        tuple(_grid(2, 1, lambda c, i: f"{pair[c]}.{ext}")),
        answers=_NUMBERED,
        right="two cameras, one instant",
    )


@_kind("instants as folders", "https://github.com/zju3dv/4K4D, and 4D scanners: a folder a frame")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    form = rng.choice(("frame_{:04d}", "{:06d}", "t{:03d}", "shot{}"))
    count, first, ext = rng.choice((2, 3, 6)), rng.choice((0, 1)), rng.choice(("png", "jpg"))
    pictures = _grid(len(names), count, lambda c, i: f"{form.format(first + i)}/{names[c]}.{ext}")
    return Folder(
        _own(names),
        _lose(rng, pictures),
        answers=_NUMBERED,
        right="each folder is an instant, each name a camera",
        script=script,
    )


@_kind(
    "two sets of a DSLR rig",
    "https://meshroom-manual.readthedocs.io/en/latest/faq/multi-camera-rig/multi-camera-rig.html",
)
def _(rng: Random) -> Folder:
    count, instants = rng.choice((2, 3, 5)), rng.choice((2, 5))
    first, root = rng.choice((1, 417)), rng.choice(("", "rig/"))
    pictures = _grid(count, instants, lambda c, i: f"{root}{c}/DSC_{first + i:04d}.JPG")
    return Folder(
        _own([str(c) for c in range(count)]),
        tuple(pictures),
        answers=_NUMBERED,
        right="folders 0, 1, ... are cameras, equal names are one instant",
    )


# What programs leave.


@_kind("frames by ffmpeg", "https://ffmpeg.org/ffmpeg-formats.html#image2-1")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    form = rng.choice(("{c}/out{n:04d}.png", "{c}/{n:05d}.jpg", "{c}_{n:04d}.png", "{c}/frame{n:d}.png"))
    first, count = rng.choice((0, 1)), rng.choice((3, 12, 40))
    pictures = _grid(len(names), count, lambda c, i: form.format(c=names[c], n=first + i))
    return Folder(
        _own(names), tuple(pictures), answers=_NUMBERED, right="equal numbers are one instant", script=script
    )


@_kind(
    "renders by Blender",
    "https://docs.blender.org/manual/en/latest/render/output/properties/stereoscopy/usage.html",
)
def _(rng: Random) -> Folder:
    count = rng.choice((1, 3, 12))
    if rng.random() < 0.5:
        names, form = ["L", "R"], rng.choice(("{n:04d}_{c}.png", "render{n:04d}_{c}.png"))
    else:
        names, form = (
            ["Camera", "Camera.001", "Camera.002"],
            rng.choice(("{c}/{n:04d}.png", "{c}_{n:04d}.png")),
        )
    pictures = _grid(len(names), count, lambda c, i: form.format(c=names[c], n=i + 1))
    return Folder(_own(names), tuple(pictures), answers=_NUMBERED, right="equal numbers are one instant")


@_kind(
    "stereo programs: left and right glued to the number",
    "https://github.com/opencv/opencv/tree/4.x/samples/data",
)
def _(rng: Random) -> Folder:
    names, form, numbers = rng.choice(
        (
            # OpenCV's samples lack number 10.
            (("left", "right"), "{c}{n:02d}.jpg", [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14]),
            (("left", "right"), "{c}{n:06d}.png", list(range(12))),
            (("L", "R"), "{c}{n:04d}.png", list(range(1, 7))),
            (("im0", "im1"), "{c}_{n:03d}.png", list(range(3))),
        )
    )
    pictures = _grid(2, len(numbers), lambda c, i: form.format(c=names[c], n=numbers[i]))
    return Folder(
        _own(names),
        _lose(rng, pictures),
        answers=_NUMBERED,
        right="two cameras, equal numbers are one instant",
    )


@_kind("machine vision: serial numbers", "https://docs.baslerweb.com/recording-images-and-videos")
def _(rng: Random) -> Folder:
    serials = [str(22_456_780 + 3 * c + rng.randrange(3)) for c in range(rng.choice((2, 3)))]
    count = rng.choice((2, 6))
    form = rng.choice(
        (
            "Basler_acA1920-40gc__{c}__20240615_1430021{n:02d}_{n:04d}.tiff",
            "cam-{c}-{n:04d}.png",
            "{c}_{n:04d}.tiff",
            "{c}/Image__{n:04d}.png",
        )
    )
    pictures = _grid(len(serials), count, lambda c, i: form.format(c=serials[c], n=i))
    extra = [f"cam-{one}" for one in serials], [f"Basler_acA1920-40gc__{one}" for one in serials]
    return Folder(
        _own(serials, *extra),
        tuple(pictures),
        answers={"fps": "30", "times": "name"},
        right="the serial number is the camera, the last number the instant",
    )


@_kind("KITTI raw", "https://www.cvlibs.net/datasets/kitti/raw_data.php")
def _(rng: Random) -> Folder:
    names, count = ["image_00", "image_01", "image_02", "image_03"][: rng.choice((2, 4))], rng.choice((4, 12))
    root = rng.choice(("", "2011_09_26_drive_0001_sync/", "2011_09_26/2011_09_26_drive_0001_sync/"))
    spare = rng.random() < 0.3  # one row more than pictures
    start = datetime(2011, 9, 26, 13, 2, 25, 964389, tzinfo=UTC)
    texts = {
        f"{root}{name}/timestamps.txt": "".join(
            f"{start + timedelta(milliseconds=103.3 * i + 0.4 * c):%Y-%m-%d %H:%M:%S.%f}445\n"
            for i in range(count + spare)
        )
        for c, name in enumerate(names)
    }
    pictures = _grid(len(names), count, lambda c, i: f"{root}{names[c]}/data/{i:010d}.png")
    return Folder(
        _own(names),
        tuple(pictures),
        texts=texts,
        answers={"timestamps": ""},
        right="times of each timestamps.txt",
    )


@_kind("KITTI odometry", "https://www.cvlibs.net/datasets/kitti/eval_odometry.php")
def _(rng: Random) -> Folder:
    names, count = ["image_0", "image_1"], rng.choice((4, 12))
    root = rng.choice(("", "sequences/00/"))
    texts = {f"{root}times.txt": "".join(f"{0.1036 * i:.6e}\n" for i in range(count))}
    texts |= {f"{root}calib.txt": "P0: 7.1 0 6.0 0 0 7.1 1.8 0 0 0 1 0\n"} if rng.random() < 0.5 else {}
    pictures = _grid(2, count, lambda c, i: f"{root}{names[c]}/{i:06d}.png")
    return Folder(
        _own(names),
        tuple(pictures),
        texts=texts,
        answers={"timestamps": ""},
        right="times.txt has both cameras' times",
    )


@_kind("KITTI stereo 2015", "https://www.cvlibs.net/datasets/kitti/eval_scene_flow.php?benchmark=stereo")
def _(rng: Random) -> Folder:
    names, count = ["image_2", "image_3"], rng.choice((3, 6))
    pictures = [
        Picture(f"{names[c]}/{i:06d}_{part}.png", Shot(c, 2 * i + half))
        for c in range(2)
        for i in range(count)
        for half, part in enumerate(("10", "11"))
    ]
    return Folder(
        _own(names),
        tuple(pictures),
        answers=_NUMBERED,
        right="equal names are one instant, 10 and 11 are two",
    )


@_kind("EuRoC", "https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets")
def _(rng: Random) -> Folder:
    names, count = ["cam0", "cam1"], rng.choice((4, 12))
    root, lost = rng.choice(("mav0/", "MH_01_easy/mav0/", "")), rng.random() < 0.4
    stamps = [1403636579763555584 + 50_000_000 * i + rng.randrange(1000) for i in range(count)]
    pictures, texts = [], {}
    for c, name in enumerate(names):
        own = [i for i in range(count) if not (lost and c and i == count // 2)]
        pictures += [Picture(f"{root}{name}/data/{stamps[i]}.png", Shot(c, i)) for i in own]
        rows = "".join(f"{stamps[i]},{stamps[i]}.png\n" for i in own)
        texts[f"{root}{name}/data.csv"] = f"#timestamp [ns],filename\n{rows}"
    texts[f"{root}imu0/data.csv"] = "#timestamp [ns],w_RS_S_x [rad s^-1]\n1403636579758555392,-0.099\n"
    return Folder(
        _own(names), tuple(pictures), texts=texts, answers={"times": "name"}, right="the times of data.csv"
    )


@_kind("TUM VI", "https://cvg.cit.tum.de/data/datasets/visual-inertial-dataset")
def _(rng: Random) -> Folder:
    names, count = ["cam0", "cam1"], rng.choice((4, 12))
    stamps = [1520530308199447626 + 50_000_000 * i for i in range(count)]
    rows = "#timestamp [ns],filename\n" + "".join(f"{s},{s}.png\n" for s in stamps)
    texts = {f"dso/{name}/times.txt": f"# id,timestamp,exposure\n{rows}" for name in names}
    pictures = _grid(2, count, lambda c, i: f"dso/{names[c]}/images/{stamps[i]}.png")
    return Folder(
        _own(names), tuple(pictures), texts=texts, answers={"times": "name"}, right="times in the names"
    )


@_kind("TUM RGB-D", "https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats")
def _(rng: Random) -> Folder:
    count = rng.choice((4, 12))
    stamps = [[1305031102.175304 + 0.0333 * i + late for i in range(count)] for late in (0, 0.0149)]
    names = ["rgb", "depth"]
    texts = {
        f"{name}.txt": "# timestamp filename\n" + "".join(f"{s:.6f} {name}/{s:.6f}.png\n" for s in stamps[c])
        for c, name in enumerate(names)
    }
    pictures = _grid(2, count, lambda c, i: f"{names[c]}/{stamps[c][i]:.6f}.png")
    return Folder(
        _own(names),
        tuple(pictures),
        texts=texts,
        answers={"times": "name"},
        unclear=True,
        right="rgb and depth, 15 ms apart; depth need not be a camera",
    )


@_kind("CMU Panoptic images", "https://github.com/CMU-Perceptual-Computing-Lab/panoptic-toolbox")
def _(rng: Random) -> Folder:
    names, count = [f"00_{c:02d}" for c in range(rng.choice((2, 5)))], rng.choice((3, 6))
    root, first = rng.choice(("hdImgs/", "171204_pose1/hdImgs/")), rng.choice((0, 1, 100))
    pictures = _grid(len(names), count, lambda c, i: f"{root}{names[c]}/{names[c]}_{first + i:08d}.jpg")
    return Folder(
        _own(names), _lose(rng, pictures), answers=_NUMBERED, right="equal last numbers are one instant"
    )


@_kind("EasyMocap", "https://chingswy.github.io/easymocap-public-doc/quickstart/quickstart.html")
def _(rng: Random) -> Folder:
    names, count = [str(c + 1) for c in range(rng.choice((3, 5)))], rng.choice((1, 3, 12))
    pictures = _grid(len(names), count, lambda c, i: f"images/{names[c]}/{i:06d}.jpg")
    return Folder(_own(names), tuple(pictures), answers=_NUMBERED, right="equal numbers are one instant")


@_kind("ZJU-MoCap", "https://github.com/zju3dv/neuralbody/blob/master/INSTALL.md")
def _(rng: Random) -> Folder:
    count = rng.choice((3, 12))
    if rng.random() < 0.5:
        names = [f"Camera_B{c + 1}" for c in range(4)]
        pictures = _grid(4, count, lambda c, i: f"{names[c]}/{i:06d}.jpg")
    else:
        names = [f"Camera ({c + 1})" for c in range(4)]
        pictures = _grid(
            4,
            count,
            lambda c, i: f"{names[c]}/Camera ({c + 1})_{i + 1:04d}_2019-08-23_16-10-50.{592 + 20 * i}.jpg",
        )
    answers = {"fps": "30", "times": "name"}  # its times agree with its numbers
    return Folder(_own(names), _lose(rng, pictures), answers=answers, right="equal numbers are one instant")


@_kind("times in the names")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    count, step_ms = rng.choice((3, 12)), rng.choice((100, 33))
    form, lost = rng.choice(("ns", "us", "s", "date")), rng.random() < 0.5
    pictures = []
    for c, name in enumerate(names):
        for i in range(count):
            if lost and c == 1 and i == 1:
                continue
            ns = 1718440202_000_000_000 + (123 + step_ms * i) * 10**6 + c * 10**6
            date = datetime.fromtimestamp(ns // 10**9, UTC)
            word = {
                "ns": f"{ns}",
                "us": f"{ns // 1000}",
                "s": f"{ns // 10**9}.{ns % 10**9 // 1000:06d}",
                "date": f"IMG_{date:%Y%m%d_%H%M%S}_{ns % 10**9 // 10**6:03d}",
            }[form]
            pictures.append(Picture(f"{name}/{word}.jpg", Shot(c, i)))
    return Folder(
        _own(names),
        tuple(pictures),
        answers={"times": "name"},
        right="the names are times, 1 ms apart within an instant",
        script=script,
    )


@_kind("images with a table of times")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    count, lost = rng.choice((6, 12)), 2
    form = rng.choice(("one", "sync", "each", "each since start"))
    pictures, rows, texts = [], [], {}
    for c, name in enumerate(names):
        # One camera lost a frame, and its files are numbered as if it had not.
        own = [i for i in range(count) if not (c == 1 and i == lost)]
        stamps = [1718440202.0 + 0.1 * i + 0.001 * c for i in own]
        if form == "each since start":
            stamps = [stamp - 1718440202.0 for stamp in stamps]
        pictures += [Picture(f"{name}/{n:04d}.jpg", Shot(c, i)) for n, i in enumerate(own)]
        rows += [(name, n, i, stamp) for n, (i, stamp) in enumerate(zip(own, stamps, strict=True))]
        if form.startswith("each"):
            own_rows = "".join(f"{n:04d}.jpg,{stamp:.6f}\n" for n, stamp in enumerate(stamps))
            texts[f"{name}.csv"] = f"filename,time\n{own_rows}"
    if form == "one":
        texts["timestamps.csv"] = "camera,frame,time\n" + "".join(f"{c},{n},{s:.6f}\n" for c, n, _, s in rows)
    if form == "sync":
        texts["timestamps.csv"] = "sync_index,cam_id,frame_time\n" + "".join(
            f"{i},{c},{s:.6f}\n" for c, n, i, s in sorted(rows, key=lambda row: row[2])
        )
    return Folder(
        _own(names),
        tuple(pictures),
        texts=texts,
        answers={"timestamps": ""},
        right="the table's times; equal numbers are false, as camera 2 lost a frame",
        script=script,
    )


@_kind("phones' photos")
def _(rng: Random) -> Folder:
    names = list(rng.choice((("anna", "ben"), ("pixel7", "galaxy"), ("Jürgen", "Zoë"))))
    forms = rng.choice((("PXL_", "PXL_"), ("IMG_", "IMG_"), ("PXL_", "IMG_")))
    count = rng.choice((1, 3))
    stamps = [MORNING + timedelta(seconds=20 * i, milliseconds=123) for i in range(count)]

    def path(c: int, i: int) -> str:
        stamp = stamps[i] + timedelta(milliseconds=30 * c)
        ms = f"{stamp.microsecond // 1000:03d}"
        return f"{names[c]}/{forms[c]}{stamp:%Y%m%d_%H%M%S}{ms if forms[c] == 'PXL_' else '_' + ms}.jpg"

    return Folder(
        _own(names),
        tuple(_grid(2, count, path)),
        answers={"times": "name", "fps": "30"},
        right="two phones, times in the names, 30 ms apart",
        script="ascii" if names[0].isascii() else "umlauts",
    )


@_kind("DSLRs whose counters differ")
def _(rng: Random) -> Folder:
    names, count = ["left", "right"], rng.choice((3, 6))
    firsts, forms = (rng.choice((1, 120)), rng.choice((417, 2033))), ("IMG_{:04d}.JPG", "DSC_{:04d}.JPG")
    pictures = _grid(2, count, lambda c, i: f"{names[c]}/{forms[c].format(firsts[c] + i)}")
    whole = rng.random() < 0.5
    return Folder(
        _own(names),
        tuple(one for one in pictures if whole or one.shot != Shot(1, 1)),
        unclear=not whole,
        answers=_NUMBERED,
        right="paired by order" if whole else "one lost a frame: a question or doubt",
    )


# Films.


def _films(
    names: Sequence[str],
    takes: Sequence[str],
    path: Callable[[str, str], str],
    *,
    frames: int = 12,
    begun: datetime | None = None,
) -> tuple[Film, ...]:
    return tuple(
        Film(
            path(take, name),
            tuple(Shot(c, i, t) for i in range(frames)),
            begun=begun and begun + timedelta(minutes=10 * t),
        )
        for t, take in enumerate(takes)
        for c, name in enumerate(names)
    )


_TAKES = (("walk",), ("walk", "run"), ("take1", "take2"), ("trial01", "trial02", "trial03"))
_SYNCHRONIZED = {"synchronized": ""}


@_kind("films: take and camera in a name")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    takes, ext = rng.choice(_TAKES), rng.choice(("mp4", "avi", "mkv", "mov"))
    form = rng.choice(("{t}_{c}", "{c}_{t}", "{t}-{c}", "{c} {t}", "{t}.{c}"))
    films = _films(names, takes, lambda t, c: f"{form.format(t=t, c=c)}.{ext}")
    return Folder(
        _own(names),
        films=films,
        texts=_litter(rng),
        answers=_SYNCHRONIZED,
        right=f"takes {', '.join(takes)} of cameras {', '.join(names)}",
        script=script,
    )


@_kind("films: folders of cameras or takes")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    takes, ext = rng.choice(_TAKES), rng.choice(("mp4", "avi", "mkv"))
    form = rng.choice(("{c}/{t}", "{t}/{c}", "{c}/{t}/video", "{t}/{c}/video", "{c}/{t}_{c}"))
    films = _films(names, takes, lambda t, c: f"{form.format(t=t, c=c)}.{ext}", frames=rng.choice((6, 12)))
    return Folder(
        _own(names),
        films=films,
        texts=_litter(rng),
        answers=_SYNCHRONIZED,
        right=f"takes {', '.join(takes)} of cameras {', '.join(names)}",
        script=script,
    )


@_kind("films: one a camera")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    ext, root = rng.choice(("mp4", "avi", "mkv", "MP4")), rng.choice(("", "videos/"))
    films = _films(names, ("take",), lambda t, c: f"{root}{c}.{ext}", frames=rng.choice((6, 12)))
    return Folder(
        _own(names), films=films, answers=_SYNCHRONIZED, right="one take, a film a camera", script=script
    )


@_kind("Human3.6M", "http://vision.imar.ro/human3.6m/description.php")
def _(rng: Random) -> Folder:
    names = ["54138969", "55011271", "58860488", "60457274"]
    takes = rng.choice((("Directions 1",), ("Directions 1", "Directions"), ("Walking", "Sitting 2")))
    films = _films(names, takes, lambda t, c: f"S1/Videos/{t}.{c}.mp4")
    return Folder(
        _own(names), films=films, answers=_SYNCHRONIZED, right=f"takes {', '.join(takes)} of 4 cameras"
    )


@_kind("Anipose", "https://pypi.org/project/anipose/")
def _(rng: Random) -> Folder:
    letters, takes = ["A", "B", "C"], rng.choice((("vid1",), ("vid1", "vid2"), ("2019-08-02-vid01",)))
    form = rng.choice(("session1/videos-raw/{t}-cam{c}.avi", "session1/videos-raw/{t}_cam{c}.mp4"))
    films = _films(letters, takes, lambda t, c: form.format(t=t, c=c))
    board = _films(letters, ("calib",), lambda t, c: f"session1/calibration/{t}-cam{c}.avi", frames=6)
    board = tuple(
        replace(film, shots=tuple(shot._replace(take=BOARD_TAKE) for shot in film.shots)) for film in board
    )
    return Folder(
        _own(letters, [f"cam{c}" for c in letters]),
        films=films + (board if rng.random() < 0.5 else ()),
        answers=_SYNCHRONIZED,
        right="cameras A, B, C; calibration is no take",
    )


@_kind("DeepLabCut 3D", "https://deeplabcut.github.io/DeepLabCut/docs/Overviewof3D.html")
def _(rng: Random) -> Folder:
    numbers, takes = ["1", "2"], rng.choice((("mouse1",), ("trial1", "trial2")))
    films = _films(numbers, takes, lambda t, c: f"{t}_camera-{c}.avi")
    boards = [
        Picture(f"calibration_images/camera-{c}-{i:02d}.jpg", None) for c in numbers for i in range(1, 4)
    ]
    return Folder(
        _own(numbers, [f"camera-{c}" for c in numbers]),
        tuple(boards if rng.random() < 0.5 else ()),
        films=films,
        answers=_SYNCHRONIZED,
        right="cameras camera-1, camera-2",
    )


@_kind("SLEAP", "https://github.com/talmolab/sleap-anipose")
def _(rng: Random) -> Folder:
    names, takes = ["back", "mid", "side", "top"], rng.choice((("minimal",), ("fly1", "fly2")))
    films = _films(names, takes, lambda t, c: f"session/{c}/{t}_{c}.mp4")
    return Folder(
        _own(names), films=films, answers=_SYNCHRONIZED, right=f"takes {', '.join(takes)} of 4 cameras"
    )


@_kind("Caliscope", "https://mprib.github.io/caliscope/project_setup/")
def _(rng: Random) -> Folder:
    word, table = rng.choice((("port", "frame_time_history.csv"), ("cam", "timestamps.csv")))
    count, cameras = 12, rng.choice((2, 3))
    key, sync = ("port", "sync_index") if word == "port" else ("cam_id", "sync_index")
    films, rows = [], []
    for c in range(cameras):
        own = [i for i in range(count) if not (c == 1 and i == 4)]
        films.append(Film(f"recordings/walk/{word}_{c}.mp4", tuple(Shot(c, i) for i in own)))
        rows += [(i, c, n, 2.5 + 0.1 * i + 0.004 * c) for n, i in enumerate(own)]
    text = f"{sync},{key},frame_index,frame_time\n" + "".join(
        f"{i},{c},{n},{t:.4f}\n" for i, c, n, t in sorted(rows)
    )
    return Folder(
        _own([f"{word}_{c}" for c in range(cameras)], map(str, range(cameras))),
        films=tuple(films),
        texts={f"recordings/walk/{table}": text},
        answers={"timestamps": ""},
        right="the table pairs the frames; camera 1 lost one",
    )


@_kind("OpenCap", "https://www.opencap.ai")
def _(rng: Random) -> Folder:
    names, takes = [f"Cam{c}" for c in range(rng.choice((2, 3)))], rng.choice((("squat",), ("squat", "walk")))
    films = _films(names, takes, lambda t, c: f"Videos/{c}/InputMedia/{t}/{t}_sync.mp4")
    return Folder(_own(names), films=films, answers=_SYNCHRONIZED, right=f"trials {', '.join(takes)}")


@_kind("mocap labs' videos", "https://docs.qualisys.com/")
def _(rng: Random) -> Folder:
    numbers = ["23087", "23091", "26012"]
    takes = rng.choice((("Walk01",), ("Walk01", "Walk02")))
    form = rng.choice(("{t}_Miqus_{k}_{c}.avi", "{t}.{c}.avi", "{t}/{t}_Miqus_{k}_{c}.avi"))
    films = _films(numbers, takes, lambda t, c: form.format(t=t, c=c, k=numbers.index(c) + 1))
    others = [f"Miqus_{k + 1}_{c}" for k, c in enumerate(numbers)], [f"Miqus_{k}" for k in (1, 2, 3)]
    return Folder(
        _own(numbers, *others, ("1", "2", "3")),
        films=films,
        answers=_SYNCHRONIZED,
        right=f"trials {', '.join(takes)} of 3 cameras",
    )


@_kind("CMU Panoptic films", "https://github.com/CMU-Perceptual-Computing-Lab/panoptic-toolbox")
def _(rng: Random) -> Folder:
    names = [f"hd_00_{c:02d}" for c in range(rng.choice((2, 5)))]
    root = rng.choice(("hdVideos/", "171204_pose1/hdVideos/"))
    films = _films(names, ("pose1",), lambda t, c: f"{root}{c}.mp4")
    return Folder(_own(names, [n[3:] for n in names]), films=films, answers=_SYNCHRONIZED, right="one take")


# Recordings split into parts.


def _parts(
    names: Sequence[str],
    counts: Sequence[int],
    path: Callable[[int, int, datetime], str],
    *,
    frames: int = 15,
    fps: int = 5,
    dated: bool = True,
) -> tuple[Film, ...]:
    """Return films of each camera in parts that touch: as many frames each, fewer in the last."""
    films = []
    for c, count in enumerate(counts):
        for part in range(count):
            length = frames if part < count - 1 else frames // 2
            begun = MORNING + timedelta(seconds=part * frames // fps)
            shots = tuple(Shot(c, part * frames + i) for i in range(length))
            films.append(Film(path(c, part, begun), shots, fps, begun if dated else None))
    return tuple(films)


def _split(
    names: Sequence[str],
    films: tuple[Film, ...],
    *others: Iterable[str],
    texts: Mapping[str, str] | None = None,
) -> Folder:
    return Folder(
        _own(names, *others),
        films=films,
        texts=texts or {},
        answers=_SYNCHRONIZED,
        right=f"one recording: cameras {', '.join(names)}, whose files are its parts",
    )


def _part_counts(rng: Random, cameras: int) -> list[int]:
    count = rng.choice((2, 3))
    return [count] * cameras


@_kind("parts: DJI", "https://www.dji.com: DJI_0041.MP4, or DJI_20240615093000_0001_D.MP4")
def _(rng: Random) -> Folder:
    names, firsts = ["drone", "osmo"], (41, 141)
    dated = rng.random() < 0.5

    def path(c: int, part: int, begun: datetime) -> str:
        word = f"{begun:%Y%m%d%H%M%S}_{firsts[c] + part:04d}_D" if dated else f"{firsts[c] + part:04d}"
        return f"{names[c]}/DJI_{word}.MP4"

    return _split(names, _parts(names, _part_counts(rng, 2), path))


@_kind("parts: GoPro", "https://community.gopro.com/s/article/GoPro-Camera-File-Naming-Convention")
def _(rng: Random) -> Folder:
    names, numbers = ["hero left", "hero right"], (41, rng.choice((41, 87)))
    old = rng.random() < 0.4

    def path(c: int, part: int, begun: datetime) -> str:
        word = ("GOPR" if not part else f"GP{part:02d}") if old else f"GX{part + 1:02d}"
        return f"{names[c]}/{word}{numbers[c]:04d}.MP4"

    films = _parts(names, _part_counts(rng, 2), path)
    thumbs = {film.path[:-4] + ".THM": "" for film in films} if rng.random() < 0.5 else {}
    return _split(names, films, texts=thumbs)


@_kind("parts: counters of Sony and Canon", "https://helpguide.sony.net: C0001.MP4; Canon: MVI_0041.MP4")
def _(rng: Random) -> Folder:
    names, forms = (
        ["A-cam", "B-cam"],
        rng.choice((("C{:04d}", "C{:04d}"), ("MVI_{:04d}", "MVI_{:04d}"), ("C{:04d}", "MVI_{:04d}"))),
    )
    firsts, dated = (1, rng.choice((1, 12))), rng.random() < 0.7
    root = rng.choice(("", "DCIM/", ""))

    def path(c: int, part: int, begun: datetime) -> str:
        return f"{root}{names[c]}/{forms[c].format(firsts[c] + part)}.MP4"

    folder = _split(names, _parts(names, _part_counts(rng, 2), path, dated=dated))
    # Counters that follow, without dates, may be takes as well.
    return replace(folder, unclear=not dated)


@_kind("parts: Insta360", "https://onlinemanual.insta360.com: VID_date_time_lens_number.mp4")
def _(rng: Random) -> Folder:
    names = ["one", "two"]

    def path(c: int, part: int, begun: datetime) -> str:
        return f"{names[c]}/VID_{MORNING:%Y%m%d_%H%M%S}_00_{41 + 60 * c + part:03d}.mp4"

    return _split(names, _parts(names, _part_counts(rng, 2), path))


@_kind("parts: dashcams", "https://support.nextbase.com/hc/en-nz/articles/21362518328349-File-Names")
def _(rng: Random) -> Folder:
    nextbase = rng.random() < 0.5
    names = ["F", "R"]

    def path(c: int, part: int, begun: datetime) -> str:
        if nextbase:
            return f"{begun:%y%m%d_%H%M%S}_{part + 1:03d}_{names[c]}H.MP4"
        return f"{begun:%Y%m%d_%H%M%S}_N{names[c]}.mp4"

    return _split(names, _parts(names, _part_counts(rng, 2), path), ("FH", "RH"), ("NF", "NR"))


@_kind("parts: Tesla", "https://www.tesla.com/ownersmanual: 2024-06-15_09-30-00-front.mp4")
def _(rng: Random) -> Folder:
    names = ["front", "back", "left_repeater", "right_repeater"]
    root = rng.choice(("", "TeslaCam/SavedClips/2024-06-15_09-35-00/"))
    films = _parts(
        names,
        _part_counts(rng, 4),
        lambda c, p, t: f"{root}{t:%Y-%m-%d_%H-%M-%S}-{names[c]}.mp4",
        dated=False,
    )
    texts = {f"{root}event.json": '{"city": "X"}'} if root else {}
    return _split(names, films, texts=texts)


@_kind("parts: NVR", "https://www.brickcom.com/support/faq_contents.php?id=106")
def _(rng: Random) -> Folder:
    names = [f"CH{c + 1}" for c in range(rng.choice((2, 3)))]
    form = rng.choice(("dates", "channel"))

    def path(c: int, part: int, begun: datetime) -> str:
        if form == "dates":
            ended = begun + timedelta(seconds=3)
            return f"{begun:%Y%m%d-%H%M%S}-{ended:%H%M%S}_192.168.1.11-{names[c]}.avi"
        return f"{names[c]}/{names[c]}_{begun:%Y%m%d%H%M%S}.mp4"

    return _split(names, _parts(names, _part_counts(rng, len(names)), path, dated=False))


@_kind("phones' films, started by hand")
def _(rng: Random) -> Folder:
    script, names = _draw_names(rng)
    takes = rng.choice((1, 2))
    form = rng.choice(("PXL_{:%Y%m%d_%H%M%S}123.mp4", "VID_{:%Y%m%d_%H%M%S}.mp4", "IMG_{n:04d}.MOV"))
    films = []
    for take in range(takes):
        for c, name in enumerate(names):
            begun = MORNING + timedelta(minutes=5 * take, seconds=c)
            path = form.format(begun, n=41 + 7 * c + take)
            shots = tuple(Shot(c, i + 10 * c, take) for i in range(30 - 3 * c))
            films.append(Film(f"{name}/{path}", shots, 10, begun))
    return Folder(
        _own(names),
        films=tuple(films),
        unpaired=True,
        right=f"{takes} takes by dates; each phone starts a second later: doubt about pairs must be said",
        script=script,
    )


# Public data sets: names of several words and numbers, of which one is the camera.


def _data_set(
    form: str, names: Sequence[str], takes: Sequence[str] = ("",), *, unclear: bool = False
) -> Folder:
    return Folder(
        _own(names),
        films=_films(names, takes, lambda t, c: form.format(t=t, c=c)),
        answers=_SYNCHRONIZED,
        unclear=unclear,
        right=f"cameras {', '.join(names)}" + (f"; takes {', '.join(takes)}" if takes[0] else ""),
    )


@_kind("AIST++", "https://aistdancedb.ongaaccel.jp/data_formats/")
def _(rng: Random) -> Folder:
    takes = rng.choice((("ch01",), ("ch01", "ch02")))
    # Two words count: without knowing the data set, either may be the camera.
    form = "gBR_sBM_{c}_d04_mBR0_{t}.mp4"
    return _data_set(form, ["c01", "c02", "c03"], takes, unclear=len(takes) > 1)


@_kind("NTU RGB+D", "https://rose1.ntu.edu.sg/dataset/actionRecognition/")
def _(rng: Random) -> Folder:
    takes = rng.choice((("A001",), ("A001", "A002")))
    form = "S001{c}P001R001{t}_rgb.avi"
    return _data_set(form, ["C001", "C002", "C003"], takes, unclear=len(takes) > 1)


@_kind("HumanEva", "http://humaneva.is.tue.mpg.de/")
def _(rng: Random) -> Folder:
    takes = rng.choice((("Walking_1",), ("Walking_1", "Jog_1")))
    return _data_set("S1/Image_Data/{t}_({c}).avi", ["C1", "C2", "C3"], takes)


@_kind("EPFL and TotalCapture", "https://www.epfl.ch/labs/cvlab/data/data-pom-index-php/")
def _(rng: Random) -> Folder:
    return rng.choice(
        (
            _data_set("{t}-{c}.avi", ["c0", "c1", "c2", "c3"], ("terrace1",)),
            _data_set("{t}-{c}.avi", ["c0", "c1", "c2", "c3"], ("terrace1", "terrace2")),
            _data_set("TC_S1_{t}_{c}.mp4", ["cam1", "cam2", "cam3"], ("acting1", "walking2")),
        )
    )


@_kind("MPI-INF-3DHP", "https://vcai.mpi-inf.mpg.de/3dhp-dataset/")
def _(rng: Random) -> Folder:
    root = rng.choice(("", "S1/Seq1/"))
    names = [f"video_{c}" for c in range(4)]
    return _data_set(root + "imageSequence/{c}.avi", names)


@_kind("cinema cameras", "https://www.arri.com: A001C003_240615_R1AB.mov")
def _(rng: Random) -> Folder:
    takes = rng.choice((("C001",), ("C001", "C002")))
    form = rng.choice(
        ("{c}001{t}_240615_R1AB.mov", "{c}001_06150930_{t}.mov", "{c}CAM/{c}001{t}_240615_R1AB.mov")
    )
    return _data_set(form, ["A", "B"], takes)


@_kind("GoPro 3D rig", "https://toddmricker.com/gopro-file-naming-convention/")
def _(rng: Random) -> Folder:
    names, numbers = ["L", "R"], [f"{n:04d}" for n in range(2, 2 + rng.choice((1, 2)))]
    if rng.random() < 0.5:
        return _data_set("3D_{c}{t}.mp4", names, numbers)
    return Folder(
        _own(names),
        tuple(_grid(2, len(numbers), lambda c, i: f"3D_{names[c]}{numbers[i]}.jpg")),
        answers=_NUMBERED,
        right="cameras L and R",
    )


@_kind("WILDTRACK", "https://www.epfl.ch/labs/cvlab/data/data-wildtrack/")
def _(rng: Random) -> Folder:
    names, count = [f"C{c + 1}" for c in range(rng.choice((3, 7)))], rng.choice((3, 8))
    pictures = _grid(len(names), count, lambda c, i: f"Image_subsets/{names[c]}/{5 * i:08d}.png")
    return Folder(_own(names), _lose(rng, pictures), answers=_NUMBERED, right="equal numbers are one instant")


@_kind("Campus and Shelf", "http://campar.in.tum.de/Chair/MultiHumanPose")
def _(rng: Random) -> Folder:
    names, count = ["Camera0", "Camera1", "Camera2"], rng.choice((3, 8))
    form = rng.choice(("{c}/campus4-c{k}-{n:05d}.png", "{c}/img_{n:06d}.png"))
    pictures = _grid(3, count, lambda c, i: form.format(c=names[c], k=c, n=i))
    return Folder(_own(names), _lose(rng, pictures), answers=_NUMBERED, right="equal numbers are one instant")


@_kind("nuScenes and Argoverse", "https://www.nuscenes.org/nuscenes#data-format")
def _(rng: Random) -> Folder:
    if rng.random() < 0.5:
        names = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK"]
        form, unit, every = "samples/{c}/n015-2018-07-24-11-22-45+0800__{c}__{t}.jpg", 10**3, 500
    else:
        names = ["ring_front_center", "ring_front_left", "ring_rear_right"]
        form, unit, every = rng.choice(("{c}/{c}_{t}.jpg", "sensors/cameras/{c}/{t}.jpg")), 1, 50
    count = rng.choice((3, 8))

    def path(c: int, i: int) -> str:
        at_ns = 1532402927_612_460_000 + (every * i + 8 * c) * 10**6
        return form.format(c=names[c], t=at_ns // unit)

    return Folder(
        _own(names),
        tuple(_grid(3, count, path)),
        answers={"times": "name"},
        right="the names end in times, 8 ms apart from camera to camera",
    )


# Traps: a refusal or a question is right.


@_kind("trap: images of one camera")
def _(rng: Random) -> Folder:
    form = rng.choice(
        (
            "IMG_{:04d}.JPG",
            "frame_{:04d}.png",
            "DSC{:05d}.JPG",
            "out{:04d}.png",
            "GOPR{:04d}.JPG",
            "scan/DSC_{:04d}.jpg",
            "left_{:04d}.jpg",
            "cam1/{:06d}.png",
            "IMG_20240615_0930{:02d}.jpg",
        )
    )
    count, first = rng.choice((2, 8, 30)), rng.choice((0, 1, 23))
    pictures = tuple(Picture(form.format(first + i), Shot(0, i)) for i in range(count))
    return Folder((("camera",),), pictures, is_one_camera=True, right="one camera walked around: no pairs")


@_kind("trap: one film")
def _(rng: Random) -> Folder:
    path = rng.choice(("video.mp4", "GX010041.MP4", "left/walk.mp4"))
    return Folder(
        (("camera",),),
        films=(Film(path, tuple(Shot(0, i) for i in range(12))),),
        is_one_camera=True,
        right="one camera",
    )


@_kind("trap: numbers only")
def _(rng: Random) -> Folder:
    count, is_rig, form = (
        rng.choice((4, 8)),
        rng.random() < 0.5,
        rng.choice(("{:02d}.jpg", "{}.png", "{:04d}.jpg")),
    )
    shots = [Shot(k, 0) if is_rig else Shot(0, k) for k in range(count)]
    pictures = tuple(Picture(form.format(k + 1), shots[k]) for k in range(count))
    return Folder(
        _own([form.format(k + 1).rpartition(".")[0] for k in range(count)]) if is_rig else (("camera",),),
        pictures,
        unclear=True,
        answers=_NUMBERED if is_rig else {},
        right="cameras of one instant, or instants of one camera: nobody can tell",
    )


@_kind("trap: two numbers, of which either is the camera")
def _(rng: Random) -> Folder:
    count, first = rng.choice((3, 4)), rng.choice((0, 1))
    swapped, form = rng.random() < 0.5, rng.choice(("{}_{}.jpg", "img_{:02d}_{:02d}.png"))

    def path(c: int, i: int) -> str:
        return form.format(*((first + i, first + c) if swapped else (first + c, first + i)))

    return Folder(
        _own([str(first + c) for c in range(count)]),
        tuple(_grid(count, count, path)),
        unclear=True,
        right="either number may be the camera: a question",
    )


@_kind("trap: numbers that never meet")
def _(rng: Random) -> Folder:
    count = rng.choice((3, 5))
    pictures = _grid(2, count, lambda c, i: f"{('left', 'right')[c]}_{1 + i + c * (count + 20):04d}.jpg")
    shots = [
        Picture(one.path, Shot(one.shot.camera, one.shot.instant + 100 * one.shot.camera))
        for one in pictures
        if one.shot
    ]
    return Folder(
        _own(("left", "right")),
        tuple(shots),
        unclear=True,
        right="no number is in both cameras, and no instant: a refusal or doubt",
    )


@_kind("trap: thumbnails, calibration and other pictures beside")
def _(rng: Random) -> Folder:
    names, numbers = ["left", "right"], _draw_numbers(rng, fewest=2)
    flat = rng.random() < 0.5
    form = "{c}_{n}.jpg" if flat else "{c}/{n}.jpg"
    pictures = _grid(2, len(numbers), lambda c, i: form.format(c=names[c], n=numbers[i]))
    beside = [
        *(Picture(f"thumbs/{form.format(c=c, n=n).replace('/', '_')}", None) for c in names for n in numbers),
        *(Picture(f"calibration/{c}_{n:02d}.png", None) for c in names for n in range(1, 4)),
        Picture("setup.jpg", None),
        *(Picture(f"@eaDir/{c}_{numbers[0]}.jpg/SYNOPHOTO_THUMB_M.jpg", None) for c in names),
    ]
    chosen = (
        beside[: len(names) * len(numbers)] if rng.random() < 0.5 else beside[len(names) * len(numbers) :]
    )
    fork = {"._left_0001.jpg": "Mac OS X        ATTR", ".DS_Store": "Bud1", "README.md": "# lab\n"}
    return Folder(
        _own(names),
        (*pictures, *chosen),
        texts=fork,
        answers=_NUMBERED,
        right="left and right; the other pictures are not cameras'",
    )
