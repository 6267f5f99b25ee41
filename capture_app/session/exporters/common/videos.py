"""Videos of a burst: H.264 in MP4, every frame at its own time, counted in microseconds."""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError, SimulshotError
from capture_app.optional_packages import load_optional
from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions, Picture, Redraw
from capture_app.session.exporters.common.tables import Frame, write_frames

TIME_BASE = Fraction(1, 1_000_000)
_QUALITY = {"crf": "15", "preset": "veryfast", "bf": "0"}
_LOSSLESS = {"qp": "0", "preset": "veryfast", "bf": "0"}
_BT601 = 6  # ITU-T H.273's number for the matrix that JPEG uses too
_LIMITED_RANGE = 1


def write_video(
    path: Path,
    frames: Iterable[tuple[int, Picture]],
    size: tuple[int, int],
    period_ns: int,
    *,
    lossless: bool = False,
) -> None:
    """Encode frames, each with its time in ns since the file's zero, to 1 us; `size` is (width, height).

    `period_ns` is how long the last frame stands. Odd sizes keep their size by unreduced colour. Lossless
    is H.264 of the very RGB values. Raises NotAvailableError without PyAV, BadInputError where two frames
    share a microsecond.
    """
    av = load_optional("av", "export", "writing videos")
    width, height = size
    odd = width % 2 or height % 2
    last_us: int | None = None
    scaler = av.video.reformatter.Interpolation
    # Without accurate rounding every picture comes out darker by half a level.
    rounding = scaler.BICUBIC | scaler.ACCURATE_RND | scaler.FULL_CHR_H_INP
    try:
        # In milliseconds, MP4's default, the time before the first frame would lose its microseconds.
        with av.open(str(path), "w", format="mp4", options={"movie_timescale": "1000000"}) as container:
            stream = container.add_stream(
                "libx264rgb" if lossless else "libx264",
                rate=Fraction(1_000_000_000, period_ns).limit_denominator(),
            )
            stream.width, stream.height = width, height
            stream.time_base = stream.codec_context.time_base = TIME_BASE
            if lossless:
                stream.pix_fmt, stream.options = "bgr24", _LOSSLESS
            else:
                stream.pix_fmt, stream.options = "yuv444p" if odd else "yuv420p", _QUALITY
                stream.codec_context.colorspace = _BT601
                stream.codec_context.color_range = _LIMITED_RANGE
            for since_ns, picture in frames:
                since_us = (since_ns + 500) // 1000
                if last_us is not None and since_us <= last_us:
                    raise BadInputError(f"{path.name}: two frames within the same microsecond, {since_us}")
                last_us = since_us
                frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
                if not lossless:
                    frame = frame.reformat(format=stream.pix_fmt, interpolation=rounding)
                frame.pts, frame.time_base = since_us, TIME_BASE
                frame.duration = max(1, period_ns // 1000)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise SimulshotError(f"cannot encode {path.name} ({width}x{height}): {error}") from error


def write_timeline(
    burst: ExportedBurst, camera: str, path: Path, file: str, options: ExportOptions
) -> list[Frame]:
    """A camera's video at the images' own times, with no frame where one is missing; `file` names it."""
    images = burst.images_of(camera)
    frames = ((image.leader_ns - burst.origin_ns, burst.pixels(image)) for image in images)
    write_video(path, frames, burst.size(camera), burst.period_ns, lossless=options.lossless)
    return [Frame(camera, image.instant, file, number, image) for number, image in enumerate(images)]


def write_instants(
    burst: ExportedBurst,
    camera: str,
    path: Path,
    file: str,
    options: ExportOptions,
    redraw: Redraw | None = None,
) -> list[Frame]:
    """A camera's video with one frame for each instant, at the instant's time; black where it has none.

    For programs that take frame n of all videos for one moment. `redraw` changes the pictures.
    """
    size = burst.size(camera)
    black = np.zeros((size[1], size[0], 3), np.uint8)
    shown = [burst.image_at(camera, instant) for instant in range(len(burst.instants_ns))]
    start_ns = burst.instants_ns[0]
    frames = (
        (instant_ns - start_ns, black if image is None else burst.pixels(image, redraw))
        for instant_ns, image in zip(burst.instants_ns, shown, strict=True)
    )
    write_video(path, frames, size, burst.period_ns, lossless=options.lossless)
    return [Frame(camera, instant, file, instant, image) for instant, image in enumerate(shown)]


def write_paired_videos(
    burst: ExportedBurst,
    folder: Path,
    files: Mapping[str, str],
    options: ExportOptions,
    redraws: Mapping[str, Redraw | None] | None = None,
) -> list[str]:
    """Write for each camera the file inside `folder`, as `write_instants` does, and frames.csv.

    Returns notes on black frames and unevenly spaced instants.
    """
    frames: list[Frame] = []
    for camera, file in files.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        redraw = (redraws or {}).get(camera)
        frames += write_instants(burst, camera, folder / file, file, options, redraw)
    write_frames(burst, folder, frames)
    blank = sum(frame.image is None for frame in frames)
    notes = [f"{blank} frames are black: their images are missing or of another moment"] if blank else []
    return notes + spacing_notes(burst.instants_ns, burst.period_ns)


def spacing_notes(times_ns: Iterable[int], period_ns: int) -> list[str]:
    """A note where a program that counts frames at a constant rate would be misled by these times."""
    gaps = np.diff(np.array(list(times_ns), np.int64))
    if len(gaps) == 0 or gaps.max() - gaps.min() <= period_ns // 20:
        return []
    return ["the instants are unevenly spaced: programs that count frames at one rate get their times wrong"]
