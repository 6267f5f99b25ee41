"""What moves: the meshes and textures of a child of rigid parts and of a pinwheel; and the wheel's stand."""

import numpy as np

from benchmarks.scenery import materials
from benchmarks.scenery.materials import Colour
from benchmarks.scenery.meshes import Mesh, box, ellipsoid, lathe, rod, sheet
from capture_app.simulation.scenes.definition import Part, Picture
from capture_app.simulation.scenes.moving_bodies import FLOOR_Y, WHEEL_HUB, turn

SKIN: Colour = (224, 168, 132)
HAIR: Colour = (106, 66, 40)


def pictures(rng: np.random.Generator) -> dict[str, Picture]:
    """Textures of the moving_bodies, by name."""
    stripes: list[Colour] = [(188, 52, 50), (240, 230, 208), (44, 60, 100), (240, 230, 208)]
    found = {
        "face": materials.face(rng, SKIN, HAIR),
        "hair": materials.hair(rng, (160, 320), HAIR),
        "shirt": materials.cloth(rng, (220, 330), stripes, stripe=17),
        "sleeve": materials.cloth(rng, (64, 96), stripes, stripe=14),
        "jeans": materials.denim(rng, (160, 200)),
        "skin": materials.plain(rng, (160, 160), SKIN, rough=0.05),
        "shoe": materials.cloth(rng, (96, 160), [(196, 54, 50)]),
        "sole": materials.plain(rng, (32, 96), (238, 234, 224)),
        "ribbon": materials.cloth(rng, (32, 32), [(62, 140, 178)]),
        "hub": materials.plain(rng, (48, 48), (238, 190, 70)),
    }
    for number in range(6):
        found[f"blade{number}"] = materials.blade(rng, number)
    return found


def parts() -> dict[str, Part]:
    """All moving parts, by the names that `poses` gives their poses."""
    child = {"hips": _hips(), "torso": _torso(), "head": _head()}
    for side in ("left", "right"):
        thigh = [
            (0.001, -0.055), (0.05, -0.045), (0.073, 0.0), (0.070, 0.08), (0.060, 0.18),
            (0.054, 0.26), (0.03, 0.29),
        ]  # fmt: skip
        child[f"{side}_thigh"] = [lathe(thigh, "jeans", depth=1.05)]
        child[f"{side}_shin"] = [
            lathe(
                [(0.03, -0.04), (0.052, -0.02), (0.054, 0.05), (0.052, 0.14), (0.049, 0.215), (0.050, 0.235)],
                "jeans",
            ),
            lathe([(0.036, 0.20), (0.034, 0.27)], "skin"),
        ]
        child[f"{side}_shoe"] = [
            ellipsoid((0.043, 0.042, 0.098), "shoe").moved((0.0, 0.016, -0.035)),
            lathe([(0.040, 0.0), (0.045, 0.006), (0.045, 0.022), (0.04, 0.026)], "sole", depth=2.25).moved(
                (0.0, 0.036, -0.035)
            ),
            lathe([(0.041, -0.035), (0.044, 0.0), (0.046, 0.03)], "shoe", depth=1.1),
        ]
        child[f"{side}_arm"] = [
            ellipsoid((0.050, 0.052, 0.050), "sleeve"),
            lathe([(0.050, 0.0), (0.050, 0.05), (0.053, 0.115), (0.050, 0.12)], "sleeve"),
            lathe([(0.034, 0.08), (0.033, 0.14), (0.031, 0.19), (0.02, 0.215)], "skin"),
        ]
        child[f"{side}_forearm"] = [
            lathe([(0.02, -0.022), (0.031, 0.0), (0.032, 0.04), (0.027, 0.12), (0.023, 0.165)], "skin"),
            ellipsoid((0.031, 0.046, 0.022), "skin").moved((0.0, 0.196, 0.0)),
            ellipsoid((0.011, 0.028, 0.012), "skin").moved((0.0, 0.186, -0.026), turn(0, -0.5)),
        ]
    found = {name: Part("figure", meshes) for name, meshes in child.items()}
    found["wheel"] = Part("pinwheel", _wheel())
    return found


def _hips() -> list[Mesh]:
    outline = [(0.098, -0.075), (0.106, -0.03), (0.112, 0.02), (0.104, 0.065), (0.06, 0.10), (0.001, 0.105)]
    return [lathe(outline, "jeans", depth=0.74)]


def _torso() -> list[Mesh]:
    outline = [
        (0.030, -0.405), (0.052, -0.395), (0.088, -0.382), (0.118, -0.360), (0.129, -0.325), (0.126, -0.26),
        (0.118, -0.18), (0.114, -0.10), (0.118, -0.03), (0.122, 0.012), (0.119, 0.016),
    ]  # fmt: skip
    neck = lathe([(0.040, -0.47), (0.040, -0.42), (0.050, -0.392)], "skin")
    return [lathe(outline, "shirt", depth=0.70, around=40), neck]


def _head() -> list[Mesh]:
    centre, radii = (0.0, -0.155, 0.0), np.array([0.100, 0.126, 0.108])
    skull = ellipsoid(radii, "face", around=48).moved(centre)
    meshes = [skull, _hair(radii * 1.075).moved(centre)]
    for side in (-1, 1):
        meshes.append(ellipsoid((0.016, 0.026, 0.018), "skin", around=14).moved((side * 0.098, -0.15, 0.004)))
        bunch = ellipsoid((0.040, 0.075, 0.044), "hair", around=20)
        meshes.append(bunch.moved((side * 0.142, -0.165, 0.03), turn(2, -side * 0.45)))
        meshes.append(
            ellipsoid((0.020, 0.020, 0.024), "ribbon", around=12).moved((side * 0.110, -0.215, 0.02))
        )
    meshes.append(ellipsoid((0.013, 0.012, 0.014), "skin", around=14).moved((0.0, -0.133, -0.107)))
    return meshes


def _hair(radii: np.ndarray) -> Mesh:
    """A cap over crown and neck: a sheet whose lower edge is high at the face, in strands."""
    around = 97
    angle = np.linspace(0, 2 * np.pi, around)
    front = np.exp(-(((angle - np.pi) / 0.95) ** 4))
    fringe = 0.10 * np.abs(np.sin(angle * 5.0 + 0.6)) * front + 0.03 * np.sin(angle * 23)
    lowest = 2.35 - 1.42 * front + fringe
    polar = np.linspace(0.02, 1.0, 14)[:, None] * lowest
    swell = 1.0 - 0.06 * (np.linspace(0, 1, 14)[:, None] > 0.95)
    rx, ry, rz = radii
    x, z = -rx * swell * np.sin(polar) * np.sin(angle), rz * swell * np.sin(polar) * np.cos(angle)
    return sheet(np.stack([x, -ry * swell * np.cos(polar), z], axis=-1), "hair", closed=True)


def _wheel() -> list[Mesh]:
    meshes = []
    inner, outer = 0.02, 0.285
    for number in range(6):
        u, v = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
        radius = inner + (outer - inner) * v
        width = np.deg2rad(55) * (1.0 - 0.22 * v**3)
        angle = width * (u - 0.5)
        # Paper that is folded forward along its leading edge, as a pinwheel's blades are.
        curl = -0.055 * u**2 * np.sin(np.pi * np.clip(v * 1.05, 0, 1)) + 0.018 * (1 - u) * v
        points = np.stack([radius * np.sin(angle), -radius * np.cos(angle), curl], axis=-1)
        meshes.append(
            sheet(points, f"blade{number}", window=(0, 1, 1, 0)).moved((0, 0, 0), turn(2, number * np.pi / 3))
        )
    meshes.append(ellipsoid((0.030, 0.030, 0.022), "hub", around=20).moved((0.0, 0.0, -0.03)))
    return meshes


def stand() -> list[Mesh]:
    """The pinwheel's pole and foot, which stand still."""
    x, y, z = WHEEL_HUB
    pole = rod((x, y, z + 0.055), (x, FLOOR_Y - 0.02, z + 0.055), 0.013, "pale_wood")
    axle = rod((x, y, z - 0.01), (x, y, z + 0.06), 0.006, "dark_wood")
    foot = lathe([(0.02, -0.035), (0.10, -0.022), (0.125, -0.012), (0.13, 0.0)], "dark_wood").moved(
        (x, FLOOR_Y, z + 0.055)
    )
    return [pole, axle, foot, *box((x, FLOOR_Y - 0.03, z + 0.055), (0.05, 0.05, 0.05), "pale_wood")]
