"""Run `capture-app phones`, and print a line with the state of the phones' clocks each second.

    python -m benchmarks.phones.served LEADER HOST FOLDER

The first line has the address of the page, the others the gateway's time (ns) of a time of the page's (us).
"""

import asyncio
import json
import socket
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from capture_app.common.address import parse_address
from capture_app.common.host_clock import host_ns
from capture_app.companions.phones.gateway import PhoneGateway
from capture_app.companions.phones.phone import Phone
from capture_app.companions.phones.phone_camera import PhoneNodes
from capture_app.console.terminal import log_line
from capture_app.web.admission import Admission
from capture_app.web.certificate import own_certificate


async def serve(leader: str, host: str, folder: Path) -> None:
    """Serve until killed."""
    admission, phones = Admission(time.monotonic), list[Phone]()
    nodes = PhoneNodes((parse_address(leader),), folder / "spool", log_line)

    def add(phone: Phone) -> None:
        phones.append(phone)
        nodes.add(phone)

    gateway = PhoneGateway(admission, add)
    listening = socket.create_server((host, 0))
    certificate = own_certificate(folder, (host,), datetime.now(UTC))
    async with gateway.serving(listening, certificate.server_context()):
        print(
            json.dumps({"url": f"https://{host}:{listening.getsockname()[1]}/#{admission.secret}"}),
            flush=True,
        )
        while True:
            await asyncio.sleep(1.0)
            for phone in phones:
                if phone.came.is_set():
                    page_us = phone.clock.page_us(host_ns())
                    told = {
                        "page_us": page_us,
                        "gateway_ns": phone.clock.gateway_ns(page_us),
                        "uncertainty_ns": phone.clock.uncertainty_ns(page_us),
                        "hard_bound_ns": phone.clock.hard_bound_ns(page_us),
                        "samples": phone.clock.samples,
                    }
                    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1], sys.argv[2], Path(sys.argv[3])))
