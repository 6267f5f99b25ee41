"""Address, certificate and invitations of a page that listens for devices."""

import socket
from datetime import UTC, datetime
from pathlib import Path

from platformdirs import user_data_path

from capture_app.common.address import ANY_HOST, Address, listen_tcp, reachable_host
from capture_app.protocol.orders import PhoneInvited
from capture_app.web.admission import Admission
from capture_app.web.certificate import load_certificate, own_certificate


class ListeningPage:
    """Listening socket with the address and the certificate that devices see."""

    def __init__(
        self,
        admission: Admission,
        host: str,
        port: int | None,
        default_port: int,
        certificate: Path | None = None,
    ) -> None:
        """Listen on a port, 0 for any; None: the default one, or any if that is in use.

        `certificate` is a file of the user's; None: one that is created here and stored. Raises NetworkError,
        BadInputError for a file without a certificate, DiskError.
        """
        self.admission = admission
        self.socket = listen_tcp(host, *((default_port, 0) if port is None else (port,)))
        shown = reachable_host(host, self.socket.family) if host in ANY_HOST else host
        self.address = Address(shown, self.socket.getsockname()[1])
        if certificate is None:
            folder = user_data_path("simulshot", appauthor=False) / "trust"
            self._certificate = own_certificate(folder, (shown, socket.gethostname()), datetime.now(UTC))
        else:
            self._certificate = load_certificate(certificate)
        self.tls = self._certificate.server_context()
        self.names = (host, *self._certificate.names())
        """Names by which requests may call this machine, besides its own."""

    async def invitation(self) -> PhoneInvited:
        """Return the page for the next device."""
        # Read the secret first: it may be a new one, whose validity starts then.
        url = f"https://{self.address}/#{self.admission.secret}"
        return PhoneInvited(
            url=url, fingerprint=self._certificate.fingerprint, good_for_s=self.admission.good_for_s
        )
