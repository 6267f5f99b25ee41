"""Signatures of a rig's leader under its answers to nodes below relays: a relay cannot make them."""

import functools
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from capture_app.common.pairing_codes import pin_of
from capture_app.trust.identity import Identity

LABEL = b"simulshot answer to a node\0"


class Proof(Struct, frozen=True):
    """Ed25519 signature under an answer, and the signer's certificate in DER."""

    certificate: Annotated[bytes, Meta(max_length=4096)]
    signature: Annotated[bytes, Meta(max_length=64)]


def sign(identity: Identity, *said: Any) -> Proof:
    """Sign what a leader says, each part as JSON."""
    return Proof(identity.certificate, _private_key(identity.file).sign(_bytes_of(said)))


def is_proven(proof: Proof | None, pins: Collection[str], *said: Any) -> bool:
    """Whether a leader with one of these pins has signed exactly this."""
    if proof is None or pin_of(proof.certificate) not in pins:
        return False
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    key = x509.load_der_x509_certificate(proof.certificate).public_key()
    try:
        assert isinstance(key, Ed25519PublicKey), "every machine's key is of this kind"
        key.verify(proof.signature, _bytes_of(said))
    except InvalidSignature:
        return False
    return True


def _bytes_of(said: Any) -> bytes:
    return LABEL + msgspec.json.encode(said)


@functools.cache
def _private_key(file: Path) -> Any:
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    return load_pem_private_key(file.read_bytes(), None)
