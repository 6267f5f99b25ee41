"""TLS certificate of the pages for phones: of a kind that browsers accept, created once and stored."""

import datetime
import hashlib
import ipaddress
import socket
import ssl
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskError
from capture_app.trust.identity import private_part

FILE = "phones.pem"
LASTS = datetime.timedelta(days=800)
"""Apple's browsers reject certificates valid for more than 825 days."""
RENEWED_BEFORE = datetime.timedelta(days=30)


@dataclass(frozen=True, slots=True)
class PageCertificate:
    """A key and its certificate in one file (PEM)."""

    file: Path
    fingerprint: str
    """SHA-256 of the certificate, as browsers show it."""

    def server_context(self) -> ssl.SSLContext:
        """Return a TLS context for the page. Raises BadInputError if the file holds no matching key."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.file)
        except (OSError, ssl.SSLError) as error:
            raise _unusable(self.file) from error
        return context

    def names(self) -> list[str]:
        """Return the host names that the certificate is for."""
        from cryptography import x509

        extensions = x509.load_pem_x509_certificate(self.file.read_bytes()).extensions
        names_of = [
            extension.value
            for extension in extensions
            if isinstance(extension.value, x509.SubjectAlternativeName)
        ]
        return [name for extension in names_of for name in extension.get_values_for_type(x509.DNSName)]


def load_certificate(file: Path) -> PageCertificate:
    """Return a certificate that the user provides. Raises BadInputError if the file lacks it or its key."""
    try:
        text = file.read_text("ascii")
        body = text[text.index("-----BEGIN CERT") :].split("-----END CERT")[0]
        der = ssl.PEM_cert_to_DER_cert(body + "-----END CERTIFICATE-----\n")
    except (OSError, ValueError) as error:
        raise _unusable(file) from error
    certificate = PageCertificate(file, hashlib.sha256(der).digest().hex(":").upper())
    certificate.server_context()
    return certificate


def own_certificate(folder: Path, hosts: Iterable[str], now: datetime.datetime) -> PageCertificate:
    """Return the certificate stored in a folder; created if it is missing or expires soon.

    It stays the same as long as possible, so that users who accepted it are not asked again.
    Raises DiskError if it cannot be stored.
    """
    path = folder / FILE
    try:
        if not _is_good(path, now):
            with private_part(path, _new_pem(hosts, now)) as part:
                system.replace(part, path)
        return load_certificate(path)
    except OSError as error:
        raise DiskError(
            f"cannot store the certificate of the phones' page in {folder}: {error.strerror or error}",
            hint="set XDG_DATA_HOME to a writable folder",
        ) from error


def _unusable(file: Path) -> BadInputError:
    return BadInputError(
        f"{file} does not contain a certificate with its key",
        hint="put both into one PEM file, the key without a password",
    )


def _is_good(path: Path, now: datetime.datetime) -> bool:
    from cryptography import x509

    try:
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        load_certificate(path)
    except (OSError, ValueError, BadInputError):
        return False
    return certificate.not_valid_before_utc <= now < certificate.not_valid_after_utc - RENEWED_BEFORE


def _new_pem(hosts: Iterable[str], now: datetime.datetime) -> bytes:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    # Browsers do not support Ed25519, the type of the machines' keys.
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, f"simulshot phones {socket.gethostname()}"[:64])]
    )
    names = [_general_name(host) for host in dict.fromkeys((*hosts, "localhost", "127.0.0.1"))]
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + LASTS)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .sign(key, hashes.SHA256())
    )
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ) + certificate.public_bytes(serialization.Encoding.PEM)


def _general_name(host: str):  # type: ignore[no-untyped-def]
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
