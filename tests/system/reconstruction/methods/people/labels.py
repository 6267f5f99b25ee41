"""Labels of a figure that moves before the cameras of the jumper, as DeepLabCut writes them."""

from pathlib import Path

import numpy as np

from benchmarks.people.figure import Floats
from reconstruction.scene.scene import Scene
from tests.project import JUMPER

JOINTS = ("head", "left_hand", "right_hand", "left_foot", "right_foot")
INSTANTS = 5


def truth() -> Floats:
    """Return the positions (instants, joints, 3) of the figure, in the calibration's unit."""
    views = list(Scene.open(JUMPER).views.values())
    middle = np.mean([view.centre for view in views], axis=0) + 2.5 * np.mean(
        [view.rotation[2] for view in views], axis=0
    )
    body = np.array([[0, -0.3, 0], [-0.3, 0, 0.1], [0.3, 0, 0], [-0.1, 0.3, 0], [0.1, 0.3, 0.1]])
    return np.asarray(middle + body + np.arange(INSTANTS)[:, None, None] * [0.02, 0, 0])


def write_csv(folder: Path, cameras: int = 9) -> Path:
    """Write a CSV for each camera, and return their folder."""
    folder.mkdir()
    heads = [["scorer", *["net"] * 15], ["bodyparts", *np.repeat(JOINTS, 3)]]
    heads.append(["coords", *["x", "y", "likelihood"] * len(JOINTS)])
    for name, table in _tables(cameras).items():
        rows = [[str(k), *map(str, row)] for k, row in enumerate(table)]
        (folder / f"{name}DLC.csv").write_text("\n".join(",".join(row) for row in heads + rows) + "\n")
    return folder


def _tables(cameras: int) -> dict[str, Floats]:
    tables = dict[str, Floats]()
    for name, view in [*Scene.open(JUMPER).views.items()][:cameras]:
        table = np.ones((INSTANTS, len(JOINTS), 3))
        points = truth().reshape(-1, 3) @ view.rotation.T + view.translation
        table[..., :2] = view.project(points).reshape(INSTANTS, -1, 2)
        tables[name] = table.reshape(INSTANTS, -1)
    return tables
