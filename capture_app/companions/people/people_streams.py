"""Streams of people in 3D to other programs: OSC datagrams, and the Lab Streaming Layer (LSL)."""

import socket
import time
from typing import Any, Protocol

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.optional_packages import load_optional
from capture_app.session.format.live_pictures import PeoplePreview

OSC_ROOT = "/simulshot"
LSL_TYPE = "MoCap"
LSL_AXES = ("X", "Y", "Z", "error")


class PeopleStream(Protocol):
    """What is sent the people of one instant after the other."""

    def send(self, found: PeoplePreview) -> None:
        """Send the people of an instant. Raises NetworkError if that fails."""

    def close(self) -> None:
        """End the stream."""


class OscStream:
    """OSC to one address: a bundle an instant with a message for each joint, `/simulshot/1/left_wrist`.

    Its arguments are x, y, z and the 95 % error; the bundle's time is the instant's by this machine's clock.
    `/simulshot/people` comes first, with how many there are and the age of the instant in s. After
    Wright and Freed (1997), https://opensoundcontrol.stanford.edu/spec-1_0.html.
    """

    def __init__(self, to: Address) -> None:
        """Raises NotAvailableError if python-osc is missing."""
        self._builders = (
            load_optional("pythonosc.osc_bundle_builder", "osc", "OSC").OscBundleBuilder,
            load_optional("pythonosc.osc_message_builder", "osc", "OSC").OscMessageBuilder,
        )
        self.to = to
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, found: PeoplePreview) -> None:
        """Send the people of an instant."""
        new_bundle, new_message = self._builders
        age_s = (found.late_ns or 0) / 1e9
        rows: list[tuple[str, tuple[float, ...]]] = [("people", (len(found.people), age_s))]
        for person in found.people:
            rows += [(f"{person.number}/{joint}", row) for joint, row in person.joints.items()]
        bundle = new_bundle(time.time() - age_s)
        for name, values in rows:
            message = new_message(f"{OSC_ROOT}/{name}")
            for value in values:
                message.add_arg(value)
            bundle.add_content(message.build())
        try:
            self._socket.sendto(bundle.build().dgram, (self.to.host, self.to.port))
        except OSError as error:
            raise NetworkError(
                f"cannot send OSC to {self.to}: {error.strerror}", hint="correct --osc"
            ) from error

    def close(self) -> None:
        """Send nothing more."""
        self._socket.close()


class LslStream:
    """An LSL stream for each person, `simulshot person 1`: x, y, z and error of every joint, NaN = unknown.

    A sample's time is the instant's. Channels and units are as in LSL's type MoCap.
    """

    def __init__(self) -> None:
        """Raises NotAvailableError if pylsl is missing or does not load."""
        self._lsl = load_optional("pylsl", "lsl", "the Lab Streaming Layer")
        self._outlets: dict[int, Any] = {}

    def send(self, found: PeoplePreview) -> None:
        """Send the people of an instant."""
        at_s = self._lsl.local_clock() - (found.late_ns or 0) / 1e9
        unknown = (float("nan"),) * len(LSL_AXES)
        for person in found.people:
            if person.number not in self._outlets:
                self._outlets[person.number] = self._open(person.number, found)
            sample = [value for joint in found.joints for value in person.joints.get(joint, unknown)]
            self._outlets[person.number].push_sample(sample, at_s)

    def close(self) -> None:
        """End all streams."""
        self._outlets.clear()

    def _open(self, number: int, found: PeoplePreview) -> Any:
        name = f"simulshot person {number}"
        channels = [(joint, axis) for joint in found.joints for axis in LSL_AXES]
        info = self._lsl.StreamInfo(name, LSL_TYPE, len(channels), self._lsl.IRREGULAR_RATE, "float32", name)
        listed = info.desc().append_child("channels")
        for joint, axis in channels:
            channel = listed.append_child("channel").append_child_value("label", f"{joint}_{axis}")
            channel.append_child_value("marker", joint).append_child_value("unit", found.unit)
            channel.append_child_value("type", "Error95" if axis == "error" else f"Position{axis}")
        return self._lsl.StreamOutlet(info)
