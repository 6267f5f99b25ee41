"""What an operator sees of a rig beside its status: news, previews, and one node in detail."""

from typing import Literal

from msgspec import Struct

from capture_app.camera_controls import ControlState

Level = Literal["info", "warning", "error"]


class NewsLine(Struct, frozen=True, kw_only=True):
    """Something that happened, as a person reads it."""

    unix_ns: int
    """When, by the teller's calendar clock; each line of one teller is later than the one before."""
    text: str
    camera: str | None = None
    """The node that it is about, where it is about one."""
    level: Level = "info"


class Preview(Struct, frozen=True, kw_only=True):
    """A small picture of what a camera sees."""

    camera: str
    leader_ns: int | None
    """Leader time of the frame; None while the node's clock is not known."""
    width: int
    """In pixels, as the height."""
    height: int
    jpeg: bytes


class NodeDetail(Struct, frozen=True, kw_only=True):
    """What a node knows of itself that is too much for a status; times in ns, newest last."""

    camera: str
    samples: tuple[tuple[int, int], ...] = ()
    """Offset (leader minus local time, as of the latest one) and round trip of exchanges with the leader."""
    phase_errors_ns: tuple[int, ...] = ()
    """Distance of the latest frames from the rig's grid."""
    log: tuple[NewsLine, ...] = ()
    fps: float | None = None
    exposure_ns: int | None = None
    gain: float | None = None
    white_balance: tuple[float, float] | None = None
    """Red and blue gains over green."""
    controls: tuple[ControlState, ...] = ()
    """As they were a few seconds ago at most."""
    spool: str = ""
    """Folder of that machine that keeps images until the leader has them; empty where memory does."""
    disk_free_bytes: int | None = None
