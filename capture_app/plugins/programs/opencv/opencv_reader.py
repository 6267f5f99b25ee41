"""Calibrations as OpenCV users save them: .npz, or YAML and XML of cv2.FileStorage; and MATLAB's .mat.

The .mat has what MATLAB's stereoParametersToOpenCV returns, or is the Calib_Results_stereo.mat of Bouguet's
toolbox, whose pixels, coefficients and poses are OpenCV's, too. DeepLabCut's stereo_params.pickle has what
cv2.stereoCalibrate returns for its pair (pose_estimation_3d/camera_calibration.py); its unit is the board's
square.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.plugins.programs.opencv.matlab_arrays import read_mat
from capture_app.session.files.pickled_arrays import read_pickle
from capture_app.session.files.untrusted_files import read_arrays
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.opencv_storage import read_storage
from capture_app.session.importing.views import View, Views, numbers, root_of, rotation_of

_MATRIX = (
    *("mtx", "k", "m", "camera_matrix", "cameramatrix", "intrinsic_matrix", "intrinsic", "intrinsics"),
    *("intrinsicmatrix", "kk"),
)
_MATRIX_NAMES = frozenset(_MATRIX)
_DISTORTION = (
    *("dist", "d", "distortion_coefficients", "distcoeffs", "dist_coeffs", "distortion"),
    *("distortioncoefficients", "kc"),
)
_ROTATION = ("r", "rvec", "rotation", "rotationofcamera2")
_TRANSLATION = ("t", "tvec", "translation", "translationofcamera2")
_PAIRS = (("1", "2"), ("0", "1"), ("l", "r"), ("left", "right"))
"""How the first and the second camera's keys end, such as M1 and M2, mtxL and mtxR, K_left and K_right."""
_FISHEYES = ("equidistant", "fisheye")
_SIZE_KEYS = ("image_width", "image_height")
_BOUGUETS = {"nx": "image_width", "ny": "image_height"}
_FISHEYE_KEY = "is fisheye"
"""Our own name for what the file says of the model."""
MAX_BYTES = 1 << 24
"""Maximum size of all arrays of a .npz; each number becomes 8 bytes."""
_DEEPLABCUTS = "stereo_params.pickle"


def _read_pair(path: Path) -> tuple[str, Mapping[str, Any]]:
    """Return the names CAMERA1-CAMERA2 of DeepLabCut's only pair, and its numbers. Raises BadInputError."""
    content = read_pickle(path, hint="write it again: deeplabcut.calibrate_cameras")
    pairs = [(str(key), pair) for key, pair in content.items() if isinstance(pair, dict)]
    if len(pairs) > 1:
        raise BadInputError(
            f"{path} has several pairs of cameras: {', '.join(key for key, _ in pairs)}",
            hint="calibrate the two cameras of the recording alone",
        )
    key, pair = pairs[0] if pairs else ("", {})
    return key, {str(name): value for name, value in pair.items()}


_LOADERS: dict[str, Callable[[Path], Mapping[str, Any]]] = {
    ".npz": partial(read_arrays, max_bytes=MAX_BYTES),
    ".mat": read_mat,
    ".pickle": lambda path: _read_pair(path)[1],
}
_SUFFIXES = (".npz", ".yml", ".yaml", ".xml", ".mat", ".pickle")

Content = Mapping[str, Array]
_IDENTITY: Content = {"r": np.eye(3), "t": np.zeros(3)}


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read OpenCV calibration files, each with its camera's name, or '' for the file of the pair.

    A camera's file has its matrix (mtx, K, camera_matrix, ...) and distortion, and may have its pose (R or
    rvec, T or tvec; x_cam = R x_rig + T). The pair's file has the R and T of cv2.stereoCalibrate, x_second =
    R x_first + T, and may have the matrices too (K1 D1 K2 D2). A folder is searched for files whose names
    begin with the cameras'. Raises BadInputError for missing or malformed files.
    """
    first = paths[0][1]
    if not first.is_dir() and first.suffix.lower() not in _SUFFIXES:
        return None
    if first.suffix.lower() == ".xml" and root_of(first) not in ("", "opencv_storage"):
        return None
    own, rest = _assign(paths, cameras)
    contents = {name: _load(path) for name, path in own.items()}
    pair = " and ".join(map(str, rest))
    if rest:
        # OpenCV's sample of stereo calibration writes intrinsics.yml and extrinsics.yml.
        joined = {key: value for path in rest for key, value in _load(path).items()}
        named = [_read_pair(path)[0] for path in rest if path.suffix == ".pickle"]
        # Left before Right, whatever their letter case.
        by_name = sorted(cameras, key=lambda name: natural_order(name.casefold()))
        in_order = next((both for both in permutations(cameras, 2) if "-".join(both) in named), by_name)
        contents.update(_split_pair(joined, pair, in_order, contents))
    elif len(contents) > 1 and all(_find(content, _ROTATION) is None for content in contents.values()):
        raise BadInputError(
            "these calibrations have no R and T",
            hint="add the pair's file with the R and T of cv2.stereoCalibrate: --calibration FILE",
        )
    if len(contents) == 1 and len(cameras) == 1:
        contents = {name: {**_IDENTITY, **content} for name, content in contents.items()}
    views = {
        name: _view(f"{own.get(name, pair)}: camera {name}", content) for name, content in contents.items()
    }
    return Views(
        views,
        ", ".join(dict.fromkeys(path.name for path in (*own.values(), *rest))),
        assumed_unit="square" if any(path.name == _DEEPLABCUTS for path in rest) else "m",
    )


def _assign(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> tuple[dict[str, Path], list[Path]]:
    own: dict[str, Path] = {}
    rest: list[Path] = []
    for name, path in paths:
        if name and name not in cameras:
            raise BadInputError(
                f"{path} names camera {name}, which is not in the recording",
                hint=f"it has {', '.join(cameras)}",
            )
        if name:
            own[name] = path
        elif path.is_dir():
            lenses, others = _search(path, cameras)
            own.update(lenses)
            rest.extend(others)
        else:
            rest.append(path)
    if len(rest) > 1 and any(_MATRIX_NAMES & _load(path).keys() for path in rest):
        raise BadInputError(
            f"the cameras of {', '.join(path.name for path in rest)} are unknown",
            hint="give --calibration NAME=FILE",
        )
    return own, rest


def _search(folder: Path, cameras: Sequence[str]) -> tuple[dict[str, Path], list[Path]]:
    known = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in _SUFFIXES and (path.suffix != ".pickle" or path.name == _DEEPLABCUTS)
    )
    # Beside OpenCV's files, a .mat is other data.
    files = [path for path in known if path.suffix.lower() != ".mat"] or known
    own: dict[str, Path] = {}
    if files and not any(
        _MATRIX_NAMES & _load(file).keys() or file.stem.casefold().startswith(name.casefold())
        for file in files
        for name in cameras
    ):
        return own, files
    for name in cameras:
        # Whole words first, so that cam1 does not match cam10's file; then L matches left.npz.
        patterns = (re.compile(re.escape(name) + end, re.IGNORECASE) for end in (r"(?![A-Za-z0-9])", ""))
        matching = ([file for file in files if pattern.match(file.stem)] for pattern in patterns)
        if (chosen := next((keys for keys in matching if len(keys) == 1), None)) is None:
            have = ", ".join(file.name for file in files) or "no OpenCV file"
            raise BadInputError(
                f"no single file in {folder} begins with {name!r}; it has {have}",
                hint="say which is whose: --calibration NAME=FILE",
            )
        own[name] = chosen[0]
    return own, [file for file in files if file not in own.values()]


def _load(path: Path) -> Content:
    """Return the numbers in a file, by lower-case name."""
    if path.suffix.lower() not in _SUFFIXES:
        raise BadInputError(
            f"{path} is not a calibration file of a known format",
            hint="known: OpenCV .npz .yml .yaml .xml, MATLAB .mat, Caliscope .toml, Qualisys .qca.txt, "
            "COLMAP, nerfstudio, ...",
        )
    values = _LOADERS.get(path.suffix.lower(), read_storage)(path)
    is_fisheye = values.get("fisheye_model") or str(values.get("distortion_model", "")) in _FISHEYES
    # In an OpenCV user's file nx and ny are a board's corners.
    sizes = _BOUGUETS if path.suffix.lower() == ".mat" else {}
    return ({_FISHEYE_KEY: np.ones(1)} if is_fisheye else {}) | {
        sizes.get(key, key.lower()): np.atleast_1d(np.asarray(value, np.float64))
        for key, value in values.items()
        if isinstance(value, int | float) or (isinstance(value, np.ndarray) and value.dtype.kind in "biuf")
    }


def _split_pair(
    content: Content, source: str, cameras: Sequence[str], own: Mapping[str, Content]
) -> dict[str, Content]:
    rotation, translation = _find(content, _ROTATION), _find(content, _TRANSLATION)
    if rotation is None or translation is None:
        raise BadInputError(
            f"{source} has no R and T; it has {', '.join(content) or 'nothing'}",
            hint="save the R and T of cv2.stereoCalibrate in it",
        )
    if len(cameras) != 2:
        raise BadInputError(
            f"{source} calibrates a pair, but the recording has {len(cameras)} cameras",
            hint="give one file a camera, each with its R and T",
        )
    poses = (_IDENTITY, {"r": rotation, "t": translation})
    sizes = {key: content[key] for key in (*_SIZE_KEYS, _FISHEYE_KEY) if key in content}
    lenses = [[_lens(content, side) for side in pair] for pair in _PAIRS]
    both = next((pair for pair in lenses if all(_MATRIX_NAMES & lens.keys() for lens in pair)), lenses[0])
    return {
        name: {**sizes, **lens, **own.get(name, {}), **pose}
        for name, lens, pose in zip(cameras, both, poses, strict=True)
    }


def _lens(content: Content, side: str) -> Content:
    """Return the matrix and the distortion of one of a pair's cameras, by the end of their names."""
    named = {
        key.removesuffix(side).rstrip("_"): table for key, table in content.items() if key.endswith(side)
    }
    return {key: table for key, table in named.items() if key in (*_MATRIX, *_DISTORTION)}


def _view(where: str, content: Content) -> View:
    matrix, rotation, translation = (_find(content, keys) for keys in (_MATRIX, _ROTATION, _TRANSLATION))
    if matrix is None or matrix.shape != (3, 3):
        raise BadInputError(f"{where} has no 3x3 camera matrix", hint=f"save it as {' or '.join(_MATRIX)}")
    if rotation is None or translation is None:
        raise BadInputError(
            f"{where} has no R and T",
            hint="add the camera's pose as R and T, or give the pair's file of cv2.stereoCalibrate",
        )
    if rotation.size not in (3, 9) or translation.size != 3:
        raise BadInputError(
            f"{where}: R and T have shapes {rotation.shape} and {translation.shape}, "
            "not the shapes of a pose",
            hint="save R as 3x3 matrix or 3 Rodrigues numbers, T as 3 numbers",
        )
    distortion = _find(content, _DISTORTION)
    size = [int(numbers(where, content, key, 1)[0]) for key in _SIZE_KEYS if key in content]
    return View(
        matrix=matrix,
        distortion=np.zeros(4) if distortion is None else distortion.ravel(),
        rotation=rotation_of(rotation.ravel()),
        translation=translation.ravel(),
        size=(size[0], size[1]) if len(size) == 2 else None,
        is_fisheye=_FISHEYE_KEY in content,
    )


def _find(content: Content, keys: Sequence[str]) -> Array | None:
    return next((content[key] for key in keys if key in content), None)


IMPORTER = Importer(
    program="OpenCV, MATLAB",
    help="a calibration's .npz, .yml, .xml or .mat of a camera or a pair, or a folder of these; DeepLabCut's "
    "stereo_params.pickle",
    read_calibration=read_calibration,
    calibration_files=(
        *("*calib*.npz", "*calib*.yml", "*calib*.xml", "Calib_Results_stereo.mat"),
        *("intrinsics.yml", "extrinsics.yml", _DEEPLABCUTS),
    ),
    calibration_per_camera=True,
    priority=-4,
)
