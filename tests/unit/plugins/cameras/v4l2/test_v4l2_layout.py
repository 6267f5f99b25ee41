"""The structs against the C compiler's rules for the kernel's own declarations, here in ctypes."""

import ctypes as c
import struct

import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.plugins.cameras.v4l2 import kernel
from capture_app.plugins.cameras.v4l2.kernel import check_layout
from capture_app.plugins.cameras.v4l2.modes import nearest_side

U32, S32 = c.c_uint32, c.c_int32


def fields(names: str, kind: type = U32) -> list[tuple[str, type]]:
    return [(name, kind) for name in names.split()]


class Fract(c.Structure):
    _fields_ = fields("numerator denominator")


class Capability(c.Structure):
    _fields_ = [
        ("driver", c.c_char * 16),
        *fields("card bus_info", c.c_char * 32),
        *fields("version capabilities device_caps"),
        ("reserved", U32 * 3),
    ]


class FormatDescription(c.Structure):
    _fields_ = [
        *fields("index type flags"),
        ("description", c.c_char * 32),
        ("pixelformat", c.c_char * 4),
        ("mbus_code", U32),
        ("reserved", U32 * 3),
    ]


class FrameSize(c.Structure):
    _fields_ = [
        ("index", U32),
        ("pixel_format", c.c_char * 4),
        ("type", U32),
        ("stepwise", U32 * 6),
        ("reserved", U32 * 2),
    ]


class FrameInterval(c.Structure):
    _fields_ = [
        ("index", U32),
        ("pixel_format", c.c_char * 4),
        *fields("width height type"),
        ("stepwise", Fract * 3),
        ("reserved", U32 * 2),
    ]


class Format(c.Structure):
    class Fmt(c.Union):
        # struct v4l2_window holds pointers, which align the union to 8 bytes.
        _fields_ = [("pix", U32 * 12), ("window", c.c_void_p * 4), ("raw_data", c.c_uint8 * 200)]

    _fields_ = [("type", U32), ("fmt", Fmt)]


class CaptureParameters(c.Structure):
    _fields_ = [*fields("capability capturemode"), ("timeperframe", Fract), ("rest", U32 * 6)]


class StreamParameters(c.Structure):
    class Parm(c.Union):
        _fields_ = [("capture", CaptureParameters), ("raw_data", c.c_uint8 * 200)]

    _fields_ = [("type", U32), ("parm", Parm)]


class RequestBuffers(c.Structure):
    _fields_ = [*fields("count type memory capabilities"), ("flags", c.c_uint8), ("reserved", c.c_uint8 * 3)]


class Buffer(c.Structure):
    class Timeval(c.Structure):
        _fields_ = fields("tv_sec tv_usec", c.c_long)

    class Timecode(c.Structure):
        _fields_ = [*fields("type flags"), ("digits", c.c_uint8 * 8)]

    class M(c.Union):
        _fields_ = [("offset", U32), ("userptr", c.c_ulong), ("planes", c.c_void_p), ("fd", S32)]

    _fields_ = [
        *fields("index type bytesused flags field"),
        ("timestamp", Timeval),
        ("timecode", Timecode),
        *fields("sequence memory"),
        ("m", M),
        *fields("length reserved2"),
        ("request_fd", S32),
    ]


class QueryControl(c.Structure):
    _fields_ = [
        *fields("id type"),
        ("name", c.c_char * 32),
        *fields("minimum maximum step default_value", S32),
        ("flags", U32),
        ("reserved", U32 * 2),
    ]


STRUCTS = {
    "QUERYCAP": Capability,
    "ENUM_FMT": FormatDescription,
    "ENUM_FRAMESIZES": FrameSize,
    "ENUM_FRAMEINTERVALS": FrameInterval,
    "S_FMT": Format,
    "G_PARM": StreamParameters,
    "S_PARM": StreamParameters,
    "REQBUFS": RequestBuffers,
    "QUERYBUF": Buffer,
    "QUERYCTRL": QueryControl,
}


@pytest.mark.parametrize("ioctl", STRUCTS)
def test_sizes_are_the_kernels(ioctl: str) -> None:
    assert ours(ioctl).size == c.sizeof(STRUCTS[ioctl])


def ours(ioctl: str) -> struct.Struct:
    return kernel.IOCTLS[ioctl][2]


def test_buffer_fields_lie_where_the_kernel_puts_them() -> None:
    packed = ours("QBUF").pack(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11)
    buffer = Buffer.from_buffer_copy(packed)
    assert (buffer.index, buffer.type, buffer.bytesused, buffer.flags, buffer.field) == (1, 2, 3, 4, 5)
    assert (buffer.timestamp.tv_sec, buffer.timestamp.tv_usec) == (6, 7)
    assert (buffer.sequence, buffer.memory, buffer.m.offset, buffer.length) == (8, 9, 10, 11)


def test_format_fields_lie_where_the_kernel_puts_them() -> None:
    packed = Format.from_buffer_copy(ours("S_FMT").pack(1, 640, 480, b"MJPG", 2, 1280, 614400))
    mjpg = struct.unpack("<I", b"MJPG")[0]
    assert packed.type == 1
    assert list(packed.fmt.pix)[:6] == [640, 480, mjpg, 2, 1280, 614400]
    assert not any(list(packed.fmt.pix)[6:])


def test_stream_parameters_lie_where_the_kernel_puts_them() -> None:
    packed = StreamParameters.from_buffer_copy(ours("S_PARM").pack(1, 0x1000, 0, 1, 30))
    capture = packed.parm.capture
    assert (packed.type, capture.capability, capture.capturemode) == (1, 0x1000, 0)
    assert (capture.timeperframe.numerator, capture.timeperframe.denominator) == (1, 30)


def test_enumerated_ranges_lie_where_the_kernel_puts_them() -> None:
    interval = FrameInterval(index=3, width=640, height=480, type=3)
    interval.pixel_format = b"YUYV"
    interval.stepwise[0] = Fract(1, 60)
    interval.stepwise[1] = Fract(1, 5)
    index, fourcc, width, height, kind, *numbers = ours("ENUM_FRAMEINTERVALS").unpack(bytes(interval))
    assert (index, fourcc, width, height, kind) == (3, b"YUYV", 640, 480, 3)
    assert numbers[:4] == [1, 60, 1, 5]


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("QUERYCAP", 0x80685600),
        ("ENUM_FMT", 0xC0405602),
        ("S_FMT", 0xC0D05605),
        ("REQBUFS", 0xC0145608),
        ("QUERYBUF", 0xC0585609),
        ("QBUF", 0xC058560F),
        ("DQBUF", 0xC0585611),
        ("STREAMON", 0x40045612),
        ("STREAMOFF", 0x40045613),
        ("G_PARM", 0xC0CC5615),
        ("S_PARM", 0xC0CC5616),
        ("G_CTRL", 0xC008561B),
        ("S_CTRL", 0xC008561C),
        ("QUERYCTRL", 0xC0445624),
        ("ENUM_FRAMESIZES", 0xC02C564A),
        ("ENUM_FRAMEINTERVALS", 0xC034564B),
    ],
)
def test_request_numbers_are_what_a_c_compiler_prints(name: str, number: int) -> None:
    assert kernel.request_number(name) == number


def test_a_32_bit_system_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(struct, "calcsize", lambda _format: 4)
    with pytest.raises(NotAvailableError, match="64-bit"):
        check_layout()


def test_sizes_in_steps_are_rounded_to_the_nearest_one() -> None:
    widths, heights = range(16, 1921, 16), range(16, 1081, 8)
    assert (nearest_side(641, widths), nearest_side(477, heights)) == (640, 480)
    assert (nearest_side(9999, widths), nearest_side(1, heights)) == (1920, 16)
