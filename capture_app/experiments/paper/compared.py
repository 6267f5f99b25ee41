"""Reads what `reconstruct compare` has found: nothing is computed here, and nothing else is known of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from capture_app.errors import BadInputError
from capture_app.experiments.paper.applications import (
    APPLICATIONS,
    BURST,
    SWEEP_STEP,
    Application,
    Measure,
    Showing,
)
from capture_app.session.reading.decoding import decode_image

METRICS = "metrics.json"
THUMBNAIL_WIDTH = 200
QUALITY = 85
HINT = "name a folder that `reconstruct compare` of this version has written"

Picture = NDArray[np.uint8]


class _Picture(msgspec.Struct):
    key: str
    synced: str
    offset: str


class _Study(msgspec.Struct):
    synced: Mapping[str, Any]
    offset: Mapping[str, Any]
    pictures: tuple[_Picture, ...] = ()


class _Burst(msgspec.Struct):
    thumbnails: tuple[tuple[str, ...], ...]


class _Sweep(msgspec.Struct):
    synced_step_px: float | None = None
    offset_step_px: float | None = None


class _Metrics(msgspec.Struct):
    session: str
    stereo: _Study | None = None
    stitch: _Study | None = None
    multiview: _Study | None = None
    poses: _Study | None = None
    burst: _Burst | None = None
    bullet_time: _Sweep | None = None


def read_compared(results: Sequence[Path], out: Path) -> tuple[Application, ...]:
    """Return all applications, with what these folders of `reconstruct compare` have of them.

    Pictures go into the folder `out`. Raises BadInputError for a folder that is not such a one.
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
    study: _Study | None = getattr(metrics, showing.study)
    if study is None:
        return application
    measures = tuple(
        Measure(label, unit, *(_number(scores.get(name), unit) for scores in (study.synced, study.offset)))
        for name, (label, unit) in showing.measures.items()
    )
    files: list[str] = []
    for picture in study.pictures:
        if picture.key == showing.picture:
            for condition, source in (("synced", picture.synced), ("offset", picture.offset)):
                files.append(f"{application.key}-{condition}.jpg")
                _save(_load(folder / source), out / files[-1])
    return msgspec.structs.replace(application, measures=measures, files=tuple(files))


def _fill_burst(application: Application, metrics: _Metrics, folder: Path, out: Path) -> Application:
    """All pictures of the burst as one, and how far what moves goes from camera to camera."""
    measures: tuple[Measure, ...] = ()
    files: tuple[str, ...] = ()
    if (sweep := metrics.bullet_time) is not None:
        measures = (Measure(SWEEP_STEP, "px", sweep.synced_step_px, sweep.offset_step_px),)
    if metrics.burst is not None and metrics.burst.thumbnails:
        rows = [
            np.concatenate([_thumbnail(folder / file) for file in row], axis=1)
            for row in metrics.burst.thumbnails
        ]
        files = (f"{application.key}.jpg",)
        _save(np.concatenate(rows), out / files[0])
    return msgspec.structs.replace(application, measures=measures, files=files)


def _number(value: Any, unit: str) -> float | None:
    if not isinstance(value, int | float):
        return None
    return 100.0 * value if unit == "%" else float(value)


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
