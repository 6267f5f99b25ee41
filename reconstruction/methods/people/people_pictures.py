"""People to look at: joints drawn into each camera's images, films of them, and plots with error bands."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.common.text import printable
from capture_app.session.exporting.videos import write_video
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import write_image
from reconstruction.common.templates import environment_of
from reconstruction.methods.people.people_run import PeopleInTime, unsure_joints
from reconstruction.methods.people.skeletons import Skeleton
from reconstruction.scene.dataset import Dataset

COLOURS = ((172, 182, 38), (40, 130, 250), (219, 86, 211), (86, 180, 233), (120, 200, 80), (80, 80, 240))
"""BGR of each person, again from the first after the last."""
FAR_PX = 1e5
"""Distance of pixels that are not drawn any more."""
PLOT_SIZE = (640, 150)
PLOTTED = 8
"""Maximum number of joints of a person in a plot; it shows the ones that move most."""


def draw_people(image: Array, view: View, found: PeopleInTime, time: int) -> Array:
    """Return an image with the people of a time: bones, and a disc of the error's size at each joint.

    An unsure joint is a ring, as its disc would hide the others.
    """
    people = [(number, one.positions[time], one.error[time]) for number, one in enumerate(found.people)]
    return draw_joints(image, view, found.skeleton, people)


def draw_joints(
    image: Array,
    view: View,
    skeleton: Skeleton,
    people: Sequence[tuple[int, Array, Array]],
    bones: float = 1 / 300,
) -> Array:
    """Return an image with people: for each a number, which chooses the colour, joints and errors.

    `bones` is the thickness of bones relative to the image's height.
    """
    picture, shade = image.copy(), image.copy()
    thick = max(1, round(image.shape[0] * bones))
    for number, positions, error in people:
        colour = COLOURS[number % len(COLOURS)]
        camera = positions @ view.rotation.T + view.translation
        ahead = np.flatnonzero(camera[:, 2] > 1e-6)
        pixels = view.project(camera[ahead])
        places = {
            k: (round(x), round(y))
            for k, (x, y) in zip(ahead.tolist(), pixels.tolist(), strict=True)
            if abs(x) + abs(y) < FAR_PX
        }
        unsure = unsure_joints(positions, error)
        for a, b in skeleton.bones:
            if a in places and b in places:
                width = max(1, thick // 2) if unsure[a] or unsure[b] else thick
                cv2.line(picture, places[a], places[b], colour, width, cv2.LINE_AA)
        for joint, place in places.items():
            if unsure[joint]:
                cv2.circle(picture, place, 3 * thick, colour, max(1, thick // 2), cv2.LINE_AA)
                continue
            radius = error[joint] * view.focal / camera[joint, 2]
            cv2.circle(shade, place, round(min(radius, 1e4)), colour, -1, cv2.LINE_AA)
            cv2.circle(picture, place, 2 * thick, colour, -1, cv2.LINE_AA)
    return np.asarray(cv2.addWeighted(picture, 0.75, shade, 0.25, 0))


def write_pictures(folder: Path, dataset: Dataset, views: Mapping[str, View], found: PeopleInTime) -> Array:
    """Write a picture of each camera at the time at which most joints are known; return the first one."""
    folder.mkdir()
    known = np.sum([np.isfinite(person.error).sum(axis=1) for person in found.people], axis=0)
    time = int(np.argmax(known))
    pictures = {
        name: draw_people(_image(dataset, name, found.times_s[time]), view, found, time)
        for name, view in views.items()
    }
    for name, picture in pictures.items():
        write_image(folder / f"{name}.jpg", picture)
    return pictures[min(pictures)]


def write_films(folder: Path, dataset: Dataset, views: Mapping[str, View], found: PeopleInTime) -> None:
    """Write a film of each camera with the people of each time; PyAV is installed."""
    folder.mkdir()
    times_ns = ((found.times_s - found.times_s[0]) * 1e9).round().astype(int)
    step_ns = round(float(np.diff(times_ns).mean())) if len(times_ns) > 1 else dataset.period_ns
    for name, view in views.items():
        pictures = (
            draw_people(_image(dataset, name, at_s), view, found, time)
            for time, at_s in enumerate(found.times_s)
        )
        frames = zip(times_ns.tolist(), pictures, strict=True)
        write_video(folder / f"{name}.mp4", frames, (view.width, view.height), step_ns)


def _image(dataset: Dataset, name: str, at_s: float) -> Array:
    """Return the camera's image nearest to a time."""
    at_ns = dataset.instants_ns[0] + at_s * 1e9
    nearest = min(dataset.instants(name), key=lambda k: abs(dataset.record(name, k).leader_ns - at_ns))
    return dataset.image(name, nearest)


def write_plots(folder: Path, found: PeopleInTime, up: Array, unit: str) -> None:
    """Write an SVG for each person: height and speed of the joints that move most, with their 95 % bands."""
    folder.mkdir()
    times_s, steps_s = found.times_s, np.diff(found.times_s)
    template = environment_of(__package__ or "").get_template("plot.svg")
    for number, person in enumerate(found.people, 1):
        extent = np.ma.masked_invalid(person.positions).var(axis=0).sum(axis=1).filled(0.0)
        rows = list[dict[str, object]]()
        for joint in [k for k in np.argsort(-extent) if extent[k] > 0][:PLOTTED]:
            path, error = person.positions[:, joint], person.error[:, joint]
            speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / steps_s
            band = np.hypot(error[1:], error[:-1]) / steps_s
            curves = {
                "height": _curve(times_s, path @ up, error),
                "speed": _curve(times_s[1:], speed, band, lowest=0.0) if np.isfinite(speed).any() else {},
            }
            rows.append({"joint": printable(found.skeleton.joints[joint]), **curves})
        text = template.render(
            rows=rows, number=number, unit=unit, begin=times_s[0], end=times_s[-1], size=PLOT_SIZE
        )
        (folder / f"person{number}.svg").write_text(text, encoding="utf-8")


def _curve(times: Array, values: Array, band: Array, lowest: float = -np.inf) -> dict[str, object]:
    """Return a curve as SVG paths with its band, and the ends of its scale; gaps stay gaps.

    The scale does not go below `lowest`.
    """
    known = np.isfinite(values)
    margin = float(np.median(band[known])) + 1e-9
    low, high = max(float(np.nanmin(values)) - margin, lowest), float(np.nanmax(values)) + margin
    width, tall = PLOT_SIZE
    x = (times - times[0]) / max(times[-1] - times[0], 1e-9) * width
    y, wide = (high - values) / (high - low) * tall, band / (high - low) * tall
    begins = np.diff(known, prepend=False) & known
    points = [*zip(begins[known], x[known], y[known], wide[known], strict=True)]
    return {
        "line": "".join(f"{'M' if begin else 'L'}{a:.1f} {b:.1f}" for begin, a, b, _ in points),
        "band": "".join(f"M{a:.1f} {b - c:.1f}V{b + c:.1f}" for _, a, b, c in points),
        "step": f"{width / max(len(times) - 1, 1) + 0.1:.2f}",
        "low": low,
        "high": high,
    }
