"""Key and certificate of a machine, made once and stored; its pin identifies it to others.

A rig's leader signs its answers to nodes below relays with that key: a relay cannot make them.
"""

import contextlib
import datetime
import errno
import functools
import os
import secrets
import ssl
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskError
from capture_app.common.file_system_limits import is_missing
from capture_app.common.pairing_codes import pin_of

FILE = "identity.pem"
LABEL = b"simulshot answer to a node\0"
"""Beginning of what a leader signs, so that a signature means nothing elsewhere."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Private key, in a file that only its user can read, and its certificate."""

    file: Path
    """File with the key and its certificate, in PEM."""
    certificate: bytes
    """Certificate in DER."""
    pin: str


def load_identity(folder: Path) -> Identity:
    """Return the identity stored in a folder; make it on first use.

    Raises DiskError if it cannot be stored, BadInputError if the file does not contain one.
    """
    path = folder / FILE
    try:
        if not path.exists():
            # If another process is faster, its key remains.
            with private_part(path, _new_pem()) as part, contextlib.suppress(FileExistsError):
                _put(part, path)
        pem = path.read_text("ascii")
        certificate = ssl.PEM_cert_to_DER_cert(pem[pem.index("-----BEGIN CERTIFICATE-----") :])
    except OSError as error:
        raise DiskError(
            f"cannot store this machine's key in {folder}: {error.strerror or error}",
            hint="set XDG_DATA_HOME to a writable folder",
        ) from error
    except ValueError as error:
        raise BadInputError(
            f"{path} does not contain a key and its certificate",
            hint="delete it, and pair this machine again",
        ) from error
    return Identity(path, certificate, pin_of(certificate))


def _put(part: Path, path: Path) -> None:
    """Give a file its name, unless another has it. Raises FileExistsError; OSError."""
    try:
        os.link(part, path)
    except OSError as error:
        if not is_missing("link", error.errno):
            raise
        if path.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        system.replace(part, path)


@contextlib.contextmanager
def private_part(path: Path, data: bytes) -> Iterator[Path]:
    """Write data to a temporary file beside `path`, readable by its user only. Raises OSError.

    The block moves or links it into place.
    """
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    handle = system.open_file(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode=0o600)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            system.sync_data(handle)
        yield part
    finally:
        part.unlink(missing_ok=True)


def _new_pem() -> bytes:
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    # A unique name: OpenSSL looks up certificates by name, and then compares with this one only.
    number = x509.random_serial_number()
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f"simulshot {number:x}"[:64])])
    # A machine's date may be off by years, and its key does not expire.
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), number)
        .not_valid_before(datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC))
        .not_valid_after(datetime.datetime(9999, 12, 31, 23, 59, 59, tzinfo=datetime.UTC))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, None)
    )
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ) + certificate.public_bytes(serialization.Encoding.PEM)


Proof = tuple[Annotated[bytes, Meta(max_length=4096)], Annotated[bytes, Meta(max_length=64)]]
"""The signer's certificate in DER, and its Ed25519 signature under an answer."""


def sign(identity: Identity, *said: Any) -> Proof:
    """Sign what a leader says, each part as JSON."""
    return identity.certificate, _private_key(identity.file).sign(_bytes_of(said))


def is_proven(proof: Proof | None, pins: Collection[str], *said: Any) -> bool:
    """Whether a leader with one of these pins has signed exactly this."""
    if proof is None or pin_of(proof[0]) not in pins:
        return False
    certificate, signature = proof
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    key = x509.load_der_x509_certificate(certificate).public_key()
    try:
        assert isinstance(key, Ed25519PublicKey), "every machine's key is of this kind"
        key.verify(signature, _bytes_of(said))
    except InvalidSignature:
        return False
    return True


def _bytes_of(said: Any) -> bytes:
    return LABEL + msgspec.json.encode(said)


@functools.cache
def _private_key(file: Path) -> Any:
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    return load_pem_private_key(file.read_bytes(), None)
