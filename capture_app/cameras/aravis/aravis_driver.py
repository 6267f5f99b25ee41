"""Driver of GigE Vision and USB3 Vision cameras: discovery and opening."""

import functools
from collections.abc import Mapping

from capture_app.cameras.aravis.aravis_camera import AravisCamera
from capture_app.cameras.aravis.aravis_library import PACKAGE, load_aravis
from capture_app.cameras.aravis.device import KIND, AravisDevice
from capture_app.cameras.base import Camera
from capture_app.cameras.specs import read_request
from capture_app.common.camera_facts import CameraListing
from capture_app.common.clock import NodeClock
from capture_app.common.errors import NotAvailableError

SPEC = f"{KIND}:ADDRESS[,key=value…]"
HELP = "GigE Vision and USB3 Vision cameras, by their IP address or serial number."
NEEDS = f"the aravis library: sudo apt install {PACKAGE}"
OPTIONS = {
    "width": "pixels of the picture, out of the middle of the sensor",
    "height": "the same",
    "fps": "frames a second (30)",
    "exposure_us": "exposure, else what the camera has set",
    "format": "pixel format by GenICam's name, such as Mono8 or BayerRG8",
    "row_us": "step that the camera rounds a frame's duration to, where it is coarser than a microsecond",
}


def open_camera(address: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Create a camera from its address (IP, serial number, or its listed name); see OPTIONS.

    It is connected when it is started. Raises BadInputError for an option that cannot be read,
    NotAvailableError without the aravis library.
    """
    request = read_request(options, "a machine-vision camera")
    load_aravis()
    return AravisCamera(functools.partial(AravisDevice, address, request)).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the cameras that answer on this machine's networks and USB; takes a second."""
    try:
        library = load_aravis()
    except NotAvailableError:
        return []
    library.update_device_list()
    listed = []
    for index in range(library.get_n_devices()):
        protocol, address = library.get_device_protocol(index), library.get_device_address(index)
        name = library.get_device_id(index)
        by_address = protocol == "GigEVision" and address
        detail = (
            f"{protocol.replace('Vision', ' Vision')}, serial number {library.get_device_serial_nbr(index)}"
        )
        model = f"{library.get_device_vendor(index)} {library.get_device_model(index)}"
        listed.append(CameraListing(f"{KIND}:{address if by_address else name}", KIND, model, detail))
    return listed
