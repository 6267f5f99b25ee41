"""IP cameras by RTSP, against a camera that the tests' own server plays: times, reconnecting, refusals."""

import asyncio
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera, parse_spec
from capture_app.common.camera_facts import PhaseControl, StampSource
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.common.passwords import hide_password, reveal_password
from capture_app.plugins.cameras.rtsp.rtsp_camera import RtspCamera
from capture_app.sync.wire.camera_commands import RestartStream
from tests.unit.plugins.cameras.rtsp.ip_camera import FPS, HEIGHT, WIDTH, IpCamera, number_shown
from tests.waiting import until

MS = 1_000_000
SOON_S = 1.0
"""As long as sender reports are waited for in these tests."""


class Streaming:
    """A camera and what it delivered."""

    def __init__(self, url: str) -> None:
        self.camera = RtspCamera(url, reports_s=SOON_S)
        self.frames: list[CapturedFrame] = []
        self.failures: list[Exception] = []

    async def start(self, frames: int = 3) -> None:
        await self.camera.start(self.frames.append, self.failures.append)
        await until(lambda: self.failures or len(self.frames) >= frames)

    def errors_ms(self, source: IpCamera) -> list[float]:
        numbers = [number_shown(frame.picture) for frame in self.frames]
        return [
            min((frame.timestamp_ns - true_ns for true_ns in source.true_ns[number]), key=abs) / MS
            for frame, number in zip(self.frames, numbers, strict=True)
        ]


@asynccontextmanager
async def streaming(source: IpCamera, frames: int = 30, login: str = "") -> AsyncIterator[Streaming]:
    async with source.running():
        one = Streaming(source.url(login))
        try:
            await one.start(frames)
            yield one
        finally:
            await one.camera.stop()


@pytest.mark.parametrize(
    ("codec", "wall_error_s", "rate_ppm"),
    [("H264", 3.0, 40.0), ("H264", -3600.0, -40.0), ("H265", -2e9, 0.0)],
)
async def test_reports_tell_when_each_picture_was_whatever_the_cameras_clock_shows(
    codec: str, wall_error_s: float, rate_ppm: float
) -> None:
    source = IpCamera(codec=codec, wall_error_s=wall_error_s, rate_ppm=rate_ppm)
    async with streaming(source) as one:
        facts = one.camera.facts
        assert (facts.kind, facts.width, facts.height, facts.pixel_format) == ("rtsp", WIDTH, HEIGHT, codec)
        assert (facts.period_ns, facts.phase_control) == (40 * MS, PhaseControl.NONE)
        assert facts.stamp_accuracy.source is StampSource.ASSUMED, (
            "how late a picture is stamped it cannot tell"
        )
        bars_ms = [frame.clock_uncertainty_ns / MS for frame in one.frames]
        errors_ms = one.errors_ms(source)
        assert all(0 < bar < 30 for bar in bars_ms)
        within = [abs(error) <= bar for error, bar in zip(errors_ms, bars_ms, strict=True)]
        assert sum(within) >= 0.9 * len(within), list(zip(errors_ms, bars_ms, strict=True))
        assert [frame.sequence for frame in one.frames] == list(range(1, len(one.frames) + 1))
        assert one.frames[0].picture.reduced(WIDTH // 2).shape == (HEIGHT // 2, WIDTH // 2, 3)
        assert one.frames[0].picture.held_bytes >= WIDTH * HEIGHT * 3 // 2


@pytest.mark.parametrize(
    "source",
    [IpCamera(report_every_s=None), IpCamera(reports_last_frame=True), IpCamera(report_jump_s=9.0)],
)
async def test_without_reports_that_can_be_true_arrivals_tell_with_a_wider_bar(source: IpCamera) -> None:
    async with streaming(source) as one:
        stamp = one.camera.facts.stamp_accuracy
        assert "timed by arrival" in one.camera.facts.model
        assert stamp.uncertainty_ns > 250 * MS
        # What the picture took to be encoded is in its time, and in the error bar of its stamp.
        late_ms = 1000 * source.max_late_s
        for error_ms, frame in zip(one.errors_ms(source), one.frames, strict=True):
            assert -5 - late_ms < error_ms - source.encoding_s * 1000 < 60 + late_ms
            assert abs(error_ms * MS - stamp.bias_ns) < stamp.uncertainty_ns + frame.clock_uncertainty_ns


async def test_pictures_after_a_lost_packet_are_dropped_until_one_is_whole() -> None:
    source = IpCamera(loses=set(range(70, 74)))
    async with streaming(source, frames=50) as one:
        sequences = [frame.sequence for frame in one.frames]
        gaps = [after - before for before, after in pairwise(sequences)]
        assert 1 < max(gaps) <= 11, gaps
        errors_ms = one.errors_ms(source)
        assert max(errors_ms) - min(errors_ms) < FPS, "a picture keeps its own time"


@pytest.mark.parametrize("algorithm", ["MD5", "SHA-256"])
async def test_a_password_is_proved_by_digest(algorithm: str) -> None:
    source = IpCamera(login=("admin", "p@ss,w:rd"), algorithm=algorithm)
    async with streaming(source, frames=1, login="admin:p%40ss%2Cw:rd") as one:
        assert one.frames


async def test_one_that_hangs_up_is_told_and_can_be_opened_again() -> None:
    source = IpCamera()
    async with streaming(source) as one:
        source.hang_up()
        await until(lambda: one.failures)
        assert "127.0.0.1 is gone" in str(one.failures[0])
        again = Streaming(source.url())
        await again.start()
        assert again.camera.facts == one.camera.facts
        await again.camera.stop()
        await again.camera.stop()
        assert len(one.failures) == 1


async def test_reports_that_begin_to_tell_another_time_end_the_stream() -> None:
    source = IpCamera()
    async with streaming(source) as one:
        source.report_jump_s = -3.0
        await until(lambda: one.failures)
        assert "jumps in time" in str(one.failures[0])


@pytest.mark.parametrize(
    ("source", "login", "needle"),
    [
        (IpCamera(login=("admin", "right")), "admin:wrong-one", "refuses the user name or the password"),
        (IpCamera(login=("admin", "right")), "", "refuses the user name or the password"),
        (IpCamera(status=461), "", "does not send over TCP"),
        (IpCamera(status=418), "", "refuses PLAY with 418"),
        (IpCamera(tells_time=False), "", "gives all its pictures the same time"),
        (IpCamera(offers="JPEG"), "", "set it to H.264 or H.265"),
    ],
)
async def test_refusals_say_what_is_wrong_and_what_to_do(source: IpCamera, login: str, needle: str) -> None:
    with pytest.raises(CameraError) as error:
        async with streaming(source, login=login):
            pass
    assert str(error.value).startswith("127.0.0.1 ")
    assert needle in str(error.value)
    assert "wrong-one" not in str(error.value)


async def test_one_that_is_not_there_is_told_at_once() -> None:
    source = IpCamera()
    async with source.running():
        pass
    with pytest.raises(CameraError, match="no camera speaks RTSP there"):
        await Streaming(source.url()).start()


async def test_what_is_no_ip_camera_is_told() -> None:
    async def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")
        writer.close()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with server:
        url = f"rtsp://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
        with pytest.raises(CameraError, match="no camera speaks RTSP there"):
            await Streaming(url).start()


async def test_what_cannot_be_asked_of_it() -> None:
    camera = open_camera("rtsp://10.0.0.9/live", clock=HostClock(), name="a")
    with pytest.raises(CameraError, match="before it starts"):
        _ = camera.facts
    with pytest.raises(CameraError, match="cannot be moved"):
        await camera.apply(RestartStream(0))
    with pytest.raises(BadInputError, match="no option 'width'"):
        open_camera("rtsp://10.0.0.9/live,width=640", clock=HostClock(), name="a")
    with pytest.raises(BadInputError, match="cannot be read"):
        open_camera("rtsp://10.0.0.9:port/live", clock=HostClock(), name="a")


def test_a_password_is_in_no_spec_that_is_kept_or_shown() -> None:
    spec = "rtsp://admin:s3cr@t,x@10.0.0.9:8554/cam?channel=1"
    assert hide_password(spec) == "rtsp://admin@10.0.0.9:8554/cam?channel=1"
    assert reveal_password("rtsp://admin@10.0.0.9:8554/other") == "rtsp://admin:s3cr@t,x@10.0.0.9:8554/other"
    assert reveal_password("rtsp://guest@10.0.0.9:8554/cam") == "rtsp://guest@10.0.0.9:8554/cam"
    assert hide_password("v4l2:/dev/video0") == "v4l2:/dev/video0"
    parsed = parse_spec(spec)
    assert parsed.label == "rtsp-10.0.0.9"
    assert "s3cr" not in repr(parsed)


def test_a_password_with_a_slash_is_hidden_and_an_address_with_an_at_in_its_path_is_kept() -> None:
    assert hide_password("rtsp://admin:s3/cr@t#?@10.0.0.7/cam") == "rtsp://admin@10.0.0.7/cam"
    revealed = reveal_password("rtsp://admin@10.0.0.7/cam")
    assert unquote(urlsplit(revealed).password or "") == "s3/cr@t#?"
    for address in ("10.0.0.7:554/live@main", "10.0.0.7/live@main", "[fe80::7]:554/a@b", "[::7]/a@b"):
        assert hide_password(f"rtsp://{address}") == f"rtsp://{address}"


def test_a_command_line_does_not_show_it_to_other_users(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib, capture_app.cli as cli\n"
        "cli.run = lambda arguments: print(pathlib.Path('/proc/self/cmdline').read_bytes()) or 0\n"
        "cli.main()\n"
    )
    if not Path("/proc/self/cmdline").exists():
        pytest.skip("no list of processes to look into")
    script = tmp_path / "command.py"
    script.write_text(code)
    spec = "rtsp://admin:s3cret@10.0.0.9/live"
    done = subprocess.run(
        [sys.executable, str(script), "node", f"--camera={spec}", spec],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "admin@10.0.0.9" in done.stdout
    assert "s3cret" not in done.stdout


async def test_a_password_is_not_sent_in_clear_text_unless_asked_for() -> None:
    source = IpCamera(login=("admin", "secret"), basic_only=True)
    async with source.running():
        camera = RtspCamera(source.url("admin:secret"))
        with pytest.raises(CameraError, match="in clear text") as refused:
            await camera.start(lambda frame: None, lambda error: None)
        assert "basic=yes" in refused.value.hint
        assert source.seen_logins == []
        camera = RtspCamera(source.url("admin:secret"), allows_basic=True)
        with pytest.raises(CameraError, match="refuses the user name"):
            await camera.start(lambda frame: None, lambda error: None)
        assert source.seen_logins[0].startswith("Basic ")


async def test_packets_before_the_first_answer_are_not_collected() -> None:
    source = IpCamera(floods=True)
    async with source.running():
        with pytest.raises(CameraError) as refused:
            await RtspCamera(source.url()).start(lambda frame: None, lambda error: None)
        assert "packets instead of an answer" in refused.value.what
