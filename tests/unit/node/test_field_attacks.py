"""Whatever a machine puts into a field of a message: it is refused, or it is bounded.

What machines have said to spoil the work of others, and the test of each (issue 42):

N1  an impossible number in a report       session/writing/test_impossible_reports.py::test_repair_leaves_out
N1b events in another camera's name        node/burst/test_untrue_reports.py::test_events_are_in_the_name
N2  `picking`, then silence                node/burst/test_untrue_reports.py::test_a_burst_ends_though
N3  texts that are too long                node/test_limits.py::test_nodes_with_long_texts
N3  lines that fill the log                protocol/test_log.py::test_one_node_and_all_together
N4  another phase in each report           sync/rig/test_grid_votes.py::test_another_phase_in_each_report
N4  a webcam with a bad clock              sync/rig/test_grid_votes.py::test_a_webcam_with_a_bad_clock
N5  images, packets and chunks as bombs    end_to_end/test_bombs.py::test_a_picture_or_truth
N5b a password asked for in clear          plugins/cameras/rtsp/test_rtsp_camera.py::test_a_password_is_not
N6  a foreign host or origin               end_to_end/screen/test_serve.py::test_the_screen_opens
N7  invitations, the rig's end, keys       node/enrolment/test_below_relays.py::test_a_relay_neither_invites
N7  a name of a camera paired here         node/enrolment/test_below_relays.py::test_a_relay_takes_no_name
N7  a name of the leader's own machine     node/enrolment/test_below_relays.py::test_no_relay_speaks
N7  4,000 made-up names                    node/enrolment/test_below_relays.py::test_a_relay_introduces
N7  an image acknowledged and kept         node/enrolment/test_receipts.py::test_a_relay_that_confirms
N7  a standby that leads beside a leader   node/enrolment/test_standby.py::test_a_standby_that_leads_beside
N8  a disk error in a recording            node/burst/test_broken_off_recordings.py::test_a_recording_goes
N9  long and deep files, pipes             companions/importing/test_bombs.py::test_a_deep_or_long_file
N10 idle connections at the phones' port   end_to_end/test_bombs.py::test_idle_connections
"""

import math
import re
import struct
import typing
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from msgspec import inspect

from benchmarks.endurance.field_attacks import attacks, example
from capture_app.common.errors import SimulshotError
from capture_app.common.text import UNREADABLE
from capture_app.companions.phones import wire as page
from capture_app.protocol.messages import ToLeader
from capture_app.protocol.orders import ToViewfinder
from capture_app.sync.wire.codec import WireError, decode, encode
from capture_app.sync.wire.datagrams import ControlMessage, Goodbye
from tests.project import ROOT

MAX_NUMBER, MAX_LETTERS, MAX_ENTRIES = 2**62, 10_000, 2_000

HEAD = encode(Goodbye(1))[:4]


def decode_datagram(plain: Any) -> Any:
    return decode(HEAD + msgspec.msgpack.encode(plain))


def decode_stream(plain: Any) -> Any:
    return msgspec.json.decode(msgspec.json.encode(plain), type=ToLeader)


def decode_viewfinder(plain: Any) -> Any:
    return msgspec.json.decode(msgspec.json.encode(plain), type=ToViewfinder)


def decode_page(plain: Any) -> Any:
    return page.decode_text(msgspec.json.encode(plain).decode())


KINDS: list[tuple[Any, Callable[[Any], Any]]] = [
    *((kind, decode_datagram) for kind in typing.get_args(ControlMessage)),
    *((kind, decode_stream) for kind in typing.get_args(ToLeader)),
    *((kind, decode_viewfinder) for kind in typing.get_args(ToViewfinder)),
    *((kind, decode_page) for kind in typing.get_args(page.Said)),
]


def unbounded(plain: Any, path: str = "") -> Iterator[str]:
    """The paths of numbers, texts and lists beyond every bound."""
    match plain:
        case bool() | None:
            return
        case int() if abs(plain) > MAX_NUMBER:
            yield f"{path}: {plain}"
        case float() if not (math.isfinite(plain) and abs(plain) <= 1e18):
            yield f"{path}: {plain}"
        case str() if len(plain) > MAX_LETTERS:
            yield f"{path}: {len(plain)} letters"
        case dict() | list() if len(plain) > MAX_ENTRIES:
            yield f"{path}: {len(plain)} entries"
        case dict():
            for key, value in plain.items():
                yield from unbounded(key, f"{path}.key")
                yield from unbounded(value, f"{path}.{key}"[:200])
        case list():
            for value in plain:
                yield from unbounded(value, f"{path}[]")


@pytest.mark.parametrize(("kind", "decoded"), KINDS, ids=[kind.__name__ for kind, _ in KINDS])
def test_each_field_of_each_message_is_refused_or_bounded(kind: Any, decoded: Callable[[Any], Any]) -> None:
    info = inspect.type_info(kind)
    plain = example(info)
    assert isinstance(decoded(plain), kind), "the example itself is a message"
    found: list[str] = []
    for path, attack in attacks(info, plain):
        try:
            message = decoded(attack)
        except (*UNREADABLE, ValueError, WireError, SimulshotError, OverflowError):
            continue
        found += (f"{path}: {what}" for what in unbounded(msgspec.to_builtins(message)))
    assert not found, found[:5]


def test_each_attack_that_succeeded_once_has_its_test() -> None:
    rows = re.findall(r"^(N\d+)b? .* (\S+\.py)::(\w+)$", __doc__ or "", re.MULTILINE)
    assert {row for row, _, _ in rows} == {f"N{number}" for number in range(1, 11)}
    for row, file, name in rows:
        tests = "".join(path.read_text() for path in (ROOT / "tests").glob(f"*/{file}"))
        assert f"def {name}" in tests, (row, file, name)


NUMBERS = (0, 1, 2**31, 2**32 - 1)
TIMES_US = (0.0, -1.0, 5e-324, 2.0**53, -(2.0**53), 1e300, math.nan, math.inf, -math.inf)


def binary_attacks() -> Iterator[bytes]:
    """Each field of a page's binary messages with each value; and of each length."""
    for kind, layout in ((page.PING, "<BIIdd"), (page.FRAME, "<BIIddd"), (page.PICTURE, "<BI"), (9, "<BI")):
        fields = [1 if of == "I" else 1.0 for of in layout[2:]]
        for place, of in enumerate(layout[2:]):
            for value in NUMBERS if of == "I" else TIMES_US:
                yield struct.pack(layout, kind, *fields[:place], value, *fields[place + 1 :])
        whole = struct.pack(layout, kind, *fields)
        yield from (whole[:length] for length in range(len(whole)))
        yield whole + b"x" * 1000


def test_each_field_of_a_pages_binary_messages_is_refused_or_bounded() -> None:
    tried = refused = 0
    for attack in binary_attacks():
        tried += 1
        try:
            message = page.decode_binary(attack)
        except ValueError:
            refused += 1
            continue
        assert not list(
            unbounded(
                msgspec.to_builtins(message)
                if not isinstance(message, page.PictureBytes)
                else {"id": message.id}
            )
        ), attack
    assert (tried > 140, refused > 100) == (True, True), (tried, refused)
