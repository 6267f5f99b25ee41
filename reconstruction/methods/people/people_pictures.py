"""People to look at: joints drawn into each camera's images, films of them, and plots with error bands."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from capture_app.common.text import printable
from capture_app.session.exporting.videos import write_video
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import write_image
from reconstruction.common.templates import environment_of
from reconstruction.methods.people.people_run import PeopleInTime
from reconstruction.scene.dataset import Dataset

COLOURS = ((172, 182, 38), (40, 130, 250), (219, 86, 211), (86, 180, 233), (120, 200, 80), (80, 80, 240))
"""BGR of each person, again from the first after the last."""
FAR_PX = 1e5
"""Distance of pixels that are not drawn any more."""
PLOT_SIZE = (640, 150)
PLOTTED = 8
"""Most joints of a person in a plot: those that move most."""


def draw_people(image: Array, view: View, found: PeopleInTime, time: int) -> Array:
    """Return an image with the people of a time: bones, and a disc of the error's size at each joint."""
    picture, shade = image.copy(), image.copy()
    thick = max(1, round(image.shape[0] / 300))
    for number, person in enumerate(found.people):
        colour = COLOURS[number % len(COLOURS)]
        camera = person.positions[time] @ view.rotation.T + view.translation
        ahead = np.isfinite(camera[:, 0]) & (camera[:, 2] > 1e-6)
        pixels = np.full((len(camera), 2), np.nan)
        pixels[ahead] = view.project(camera[ahead])
        places = {
            k: (round(x), round(y))
            for k, (x, y) in enumerate(pixels.tolist())
            if ahead[k] and abs(x) + abs(y) < FAR_PX
        }
        for a, b in found.skeleton.bones:
            if a in places and b in places:
                cv2.line(picture, places[a], places[b], colour, thick, cv2.LINE_AA)
        for joint, place in places.items():
            radius = person.error[time, joint] * view.focal / camera[joint, 2]
            cv2.circle(shade, place, round(min(radius, 1e4)), colour, -1, cv2.LINE_AA)
            cv2.circle(picture, place, 2 * thick, colour, -1, cv2.LINE_AA)
    return np.asarray(cv2.addWeighted(picture, 0.75, shade, 0.25, 0))


def write_pictures(folder: Path, dataset: Dataset, views: Mapping[str, View], found: PeopleInTime) -> None:
    """Write a picture of each camera at the time at which most joints are known."""
    folder.mkdir()
    known = np.sum([np.isfinite(person.error).sum(axis=1) for person in found.people], axis=0)
    time = int(np.argmax(known))
    for name, view in views.items():
        image = _image(dataset, name, found.times_s[time])
        write_image(folder / f"{name}.jpg", draw_people(image, view, found, time))


def write_films(folder: Path, dataset: Dataset, views: Mapping[str, View], found: PeopleInTime) -> None:
    """Write a film of each camera with the people of each time; PyAV is installed."""
    folder.mkdir()
    step_ns = (
        round(float(np.diff(found.times_s).mean()) * 1e9) if len(found.times_s) > 1 else dataset.period_ns
    )

    def frames(name: str, view: View) -> Iterator[tuple[int, Array]]:
        for time, at_s in enumerate(found.times_s):
            picture = draw_people(_image(dataset, name, at_s), view, found, time)
            yield round((at_s - found.times_s[0]) * 1e9), picture

    for name, view in views.items():
        write_video(folder / f"{name}.mp4", frames(name, view), (view.width, view.height), step_ns)


def _image(dataset: Dataset, name: str, at_s: float) -> Array:
    """Return the camera's image nearest to a time."""
    there = dataset.instants(name)
    at_ns = [abs(dataset.record(name, k).leader_ns - dataset.instants_ns[0] - at_s * 1e9) for k in there]
    return dataset.image(name, there[int(np.argmin(at_ns))])


def write_plots(folder: Path, found: PeopleInTime, up: Array, unit: str) -> None:
    """Write an SVG for each person: height and speed of the joints that move most, with their 95 % bands."""
    folder.mkdir()
    for number, person in enumerate(found.people, 1):
        known = [path[np.isfinite(path[:, 0])] for path in person.positions.transpose(1, 0, 2)]
        extent = np.array([float(path.var(axis=0).sum()) if len(path) else 0.0 for path in known])
        rows = []
        for joint in np.argsort(-extent)[:PLOTTED]:
            height, error = person.positions[:, joint] @ up, person.error[:, joint]
            if np.isfinite(height).sum() > 2:
                steps = np.diff(found.times_s)
                speed = np.linalg.norm(np.diff(person.positions[:, joint], axis=0), axis=1) / steps
                spread = np.hypot(error[1:], error[:-1]) / steps
                rows.append({
                    "joint": printable(found.skeleton.joints[joint]),
                    "height": _curve(found.times_s, height, error),
                    "speed": _curve(found.times_s[1:], speed, spread),
                })  # fmt: skip
        page = environment_of(__package__ or "").get_template("plot.svg")
        text = page.render(
            rows=rows, number=number, unit=unit, begin=found.times_s[0], end=found.times_s[-1], size=PLOT_SIZE
        )
        (folder / f"person{number}.svg").write_text(text, encoding="utf-8")


def _curve(times: Array, values: Array, band: Array) -> dict[str, object]:
    """Return a curve as SVG paths with its band, and the ends of its scale; gaps stay gaps."""
    known = np.isfinite(values)
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = float(np.nanmedian(band[known])) + 1e-9
    low, high = low - margin, high + margin
    width, tall = PLOT_SIZE
    x = (times - times[0]) / max(times[-1] - times[0], 1e-9) * width
    y = (high - values) / (high - low) * tall
    wide = np.clip(band, 0, high - low) / (high - low) * tall
    edges = np.nonzero(np.diff(known.astype(int), prepend=0, append=0))[0].reshape(-1, 2)

    def path(points: Iterable[Array]) -> str:
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points)

    line, upper, lower = (np.column_stack([x, y + sign * wide]) for sign in (0, -1, 1))
    return {
        "line": " ".join(path(line[a:b]) for a, b in edges),
        "band": " ".join(path([*upper[a:b], *lower[a:b][::-1]]) + "Z" for a, b in edges),
        "low": low,
        "high": high,
    }
