"""The paper's applications, with the command that shows the same for a bundled session, and its results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.session.reading.decoding import decode_image
from reconstruction.compare.comparison import CompareOptions, compare

BURST, SWEEP_STEP = "burst", "what moves, from picture to picture in the sweep"


class Measure(msgspec.Struct, frozen=True):
    """A value for synchronized images, and for offset images."""

    label: str
    unit: str
    synced: float | None
    offset: float | None


class Application(msgspec.Struct, frozen=True, kw_only=True):
    """What the paper shows, the equivalent command, and that command's results."""

    key: str
    place: str
    title: str
    command: str
    engine: str = ""
    """Method that computes its depth, as a sentence."""
    measures: tuple[Measure, ...] = ()
    files: tuple[str, ...] = ()
    """Pictures of both conditions, synchronized first; a single one is synchronized."""


@dataclass(frozen=True, slots=True)
class Showing:
    """An application, and its place in the results of `reconstruct compare`."""

    application: Application
    session: str
    study: str
    """Name of the study in `metrics.json`."""
    picture: str = ""
    measures: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Label and unit by measure; measures of another study are prefixed with its name and a point."""


_COMPARE = "reconstruct compare sample_sessions"
_DEPTH = {
    "mover_within_2pct": ("what moves, its distance within 2 % of the truth", "%"),
    "static_within_2pct": ("what stands still (control)", "%"),
}
_COLMAP = {
    "triangulation.mover_points": ("points that COLMAP places on what moves", ""),
    "triangulation.mover_precision": ("of these, at a distance within 2 % of the truth", "%"),
    "triangulation.static_points": ("points that COLMAP places on what stands still (control)", ""),
}
APPLICATIONS = (
    Showing(
        Application(
            key="figures-1-2-10",
            place="Figures 1, 2 and 10",
            title="A burst of five views (a row for each camera), and collages of one instant",
            command=f"{_COMPARE}/jumper",
        ),
        "jumper",
        BURST,
    ),
    Showing(
        Application(
            key="figure-8",
            place="Figure 8",
            title="Depth of a jumping person from a pair of cameras, and 66 ms apart",
            command=f"{_COMPARE}/jumper --offset-ms 66",
            engine="The paper uses COLMAP for depth. Here it is OpenCV's semi-global block matching (SGBM). "
            "COLMAP's points of all views are counted below.",
        ),
        "jumper",
        "stereo",
        "stereo_depth",
        _DEPTH | _COLMAP,
    ),
    Showing(
        Application(
            key="five-views",
            place="Applications",
            title="Depth from five views, and at offsets from -66 to 66 ms",
            command=f"{_COMPARE}/jumper",
            engine="Depth is from our plane sweep, not from COLMAP, whose stereo needs a GPU.",
        ),
        "jumper",
        "multiview",
        "multiview_depth",
        _DEPTH,
    ),
    Showing(
        Application(
            key="figure-9",
            place="Figure 9",
            title="Where two pictures of a panorama overlap, laid over each other, and 66 ms apart",
            command=f"{_COMPARE}/crossing --offset-ms 66",
        ),
        "crossing",
        "panorama",
        "panorama_overlap",
        {
            "mover_misfit_px": ("what moves, alignment error", "px"),
            "static_misfit_px": ("what stands still (control)", "px"),
        },
    ),
    Showing(
        Application(
            key="pinwheel",
            place="Supplement",
            title="A rotating pinwheel, where poses found from single instants fail",
            command=f"{_COMPARE}/pinwheel",
        ),
        "pinwheel",
        "poses",
        "",
        {
            "correct_pairs": ("pairs of cameras placed right", "%"),
            "rotation_deg": ("error of the rotation between two cameras", "degrees"),
        },
    ),
)
"""Applications in page order."""


SAMPLES = Path(__file__).resolve().parents[2] / "sample_sessions"
METRICS = "metrics.json"
THUMBNAIL_WIDTH = 200
QUALITY = 85
HINT = "name a folder that `reconstruct compare` of this version has written"

Picture = NDArray[np.uint8]


class _Picture(msgspec.Struct):
    key: str
    synced: str
    offset: str


class _Value(msgspec.Struct):
    value: float


class _Measure(msgspec.Struct):
    name: str
    synced: _Value | None = None
    offset: _Value | None = None


class _Facts(msgspec.Struct):
    thumbnails: tuple[tuple[str, ...], ...] = ()
    synced_step_px: float | None = None
    offset_step_px: float | None = None


class _Study(msgspec.Struct):
    name: str
    measures: tuple[_Measure, ...] = ()
    pictures: tuple[_Picture, ...] = ()
    facts: _Facts | None = None


class _Metrics(msgspec.Struct):
    session: str
    studies: tuple[_Study, ...] = ()


def compare_samples(folder: Path, *, quick: bool) -> list[Path]:
    """Compare the applications' sessions into folders of their names; `quick` uses small sessions.

    Raises what `reconstruct compare` raises.
    """
    less: dict[str, Any] = (
        {"max_instants": 2, "max_multiview_instants": 1, "multiview_width": 320} if quick else {}
    )
    made = []
    for session in dict.fromkeys(showing.session for showing in APPLICATIONS):
        made.append(folder / session)
        compare(SAMPLES / session, made[-1], CompareOptions.of(**less))
    return made


def read_compared(results: Sequence[Path], out: Path) -> tuple[Application, ...]:
    """Return all applications, with their values from these folders of `reconstruct compare`.

    Pictures go into the folder `out`. Raises BadInputError for a folder without such results.
    """
    found = {showing.application.key: showing.application for showing in APPLICATIONS}
    for folder in results:
        path = folder / METRICS
        try:
            metrics = msgspec.json.decode(path.read_bytes(), type=_Metrics)
        except OSError as error:
            raise BadInputError(f"cannot read {path}: {error.strerror}", hint=HINT) from None
        except msgspec.DecodeError as error:
            raise BadInputError(f"cannot read {path}: {error}", hint=HINT) from None
        for showing in APPLICATIONS:
            if showing.session == Path(metrics.session).name:
                found[showing.application.key] = _fill(showing, metrics, folder, out)
    return tuple(found.values())


def _fill(showing: Showing, metrics: _Metrics, folder: Path, out: Path) -> Application:
    application = showing.application
    if showing.study == BURST:
        return _fill_burst(application, metrics, folder, out)
    study = next((one for one in metrics.studies if one.name == showing.study), None)
    if study is None or not study.measures:
        return application
    found = {f"{each.name}.{one.name}": one for each in metrics.studies for one in each.measures}
    found |= {one.name: one for one in study.measures}
    measures = tuple(
        Measure(label, unit, _number(found[name].synced, unit), _number(found[name].offset, unit))
        for name, (label, unit) in showing.measures.items()
        if name in found
    )
    files: list[str] = []
    for picture in study.pictures:
        if picture.key == showing.picture:
            for condition, source in (("synced", picture.synced), ("offset", picture.offset)):
                files.append(f"{application.key}-{condition}.jpg")
                _save(_load(folder / source), out / files[-1])
    return msgspec.structs.replace(application, measures=measures, files=tuple(files))


def _fill_burst(application: Application, metrics: _Metrics, folder: Path, out: Path) -> Application:
    """Draw all images of the burst as one, and measure motion from camera to camera."""
    measures: tuple[Measure, ...] = ()
    files: tuple[str, ...] = ()
    facts = {one.name: one.facts for one in metrics.studies}
    if (sweep := facts.get("bullet_time")) is not None:
        measures = (Measure(SWEEP_STEP, "px", sweep.synced_step_px, sweep.offset_step_px),)
    if (grid := facts.get("burst")) is not None and grid.thumbnails:
        rows = [
            np.concatenate([_thumbnail(folder / file) for file in row], axis=1) for row in grid.thumbnails
        ]
        files = (f"{application.key}.jpg",)
        _save(np.concatenate(rows), out / files[0])
    return msgspec.structs.replace(application, measures=measures, files=files)


def _number(found: _Value | None, unit: str) -> float | None:
    if found is None:
        return None
    return 100.0 * found.value if unit == "%" else found.value


def _load(path: Path) -> Picture:
    try:
        picture = decode_image(path.read_bytes(), colour=True)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}", hint=HINT) from None
    if picture is None:
        raise BadInputError(f"{path} is not a picture", hint=HINT)
    return picture


def _thumbnail(path: Path) -> Picture:
    picture = _load(path)
    size = THUMBNAIL_WIDTH, round(picture.shape[0] * THUMBNAIL_WIDTH / picture.shape[1])
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _save(picture: Picture, path: Path) -> None:
    _, data = cv2.imencode(path.suffix, picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    path.write_bytes(data.tobytes())
