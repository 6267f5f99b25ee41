"""The pictures of a panorama, synchronized and offset: the whole, and where it differs most."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from reconstruction.common.drawing import box_with_most, enlarge_crop, trim_empty_sides
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.panorama.pair_panorama import blend_pair
from reconstruction.panorama.pair_registration import PairRegistration
from reconstruction.scores.results import Picture

FEWEST_GREY_LEVELS = 12
"""A difference between the conditions smaller than this is noise."""
TEXTS = {
    "panorama": ("Panorama", "Two pictures laid side by side and cross-faded where they overlap."),
    "panorama_closeup": (
        "Where they overlap, close up",
        "A thing that moved between the two pictures is there twice, half transparent.",
    ),
}


def panorama_pictures(
    registration: PairRegistration, photos: Mapping[str, tuple[Array, Array]], out: Path
) -> tuple[Picture, ...]:
    """Blend both cameras' photos (BGR) of each side into pictures in out/pictures."""
    part = trim_empty_sides(registration.seen[0] | registration.seen[1])
    wholes = {side: blend_pair(registration, *pair)[part] for side, pair in photos.items()}
    changed = np.abs(wholes["synced"].astype(np.float32) - wholes["offset"]).mean(2)
    box = box_with_most(changed * (changed > FEWEST_GREY_LEVELS), 0.5)
    paths: dict[str, dict[str, str]] = {key: {} for key in TEXTS}
    for side, whole in wholes.items():
        for key, picture in (("panorama", whole), ("panorama_closeup", enlarge_crop(whole, box))):
            paths[key][side] = save_picture(out, f"{key}_{side}.jpg", picture)
    return tuple(
        Picture(key=key, title=title, caption=text, synced=paths[key]["synced"], offset=paths[key]["offset"])
        for key, (title, text) in TEXTS.items()
    )
