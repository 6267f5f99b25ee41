"""The certificate of the page: what browsers take, kept as long as it is good."""

import datetime
import ssl
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes

from capture_app.common.errors import BadInputError
from capture_app.web.certificate import LASTS, load_certificate, own_certificate

NOW = datetime.datetime(2026, 5, 1, tzinfo=datetime.UTC)


def test_it_is_of_a_kind_that_browsers_take(tmp_path: Path) -> None:
    made = own_certificate(tmp_path, ("192.168.1.20", "workshop"), NOW)
    certificate = x509.load_pem_x509_certificate(made.file.read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "192.168.1.20" in map(str, names.get_values_for_type(x509.IPAddress))
    assert "workshop" in names.get_values_for_type(x509.DNSName)
    assert certificate.not_valid_after_utc - certificate.not_valid_before_utc < datetime.timedelta(days=825)
    assert made.fingerprint == certificate.fingerprint(hashes.SHA256()).hex(":").upper()
    assert made.file.stat().st_mode & 0o077 == 0
    assert isinstance(made.server_context(), ssl.SSLContext)


def test_it_stays_the_same_until_it_is_about_to_end(tmp_path: Path) -> None:
    made = own_certificate(tmp_path, ("192.168.1.20",), NOW)
    assert own_certificate(tmp_path, ("10.0.0.1",), NOW + LASTS / 2) == made
    assert own_certificate(tmp_path, ("10.0.0.1",), NOW + LASTS).fingerprint != made.fingerprint


def test_a_damaged_one_is_made_anew(tmp_path: Path) -> None:
    made = own_certificate(tmp_path, (), NOW)
    made.file.write_text("no certificate")
    assert own_certificate(tmp_path, (), NOW).fingerprint != made.fingerprint


def test_one_of_the_users_own_must_have_its_key(tmp_path: Path) -> None:
    file = tmp_path / "own.pem"
    made = own_certificate(tmp_path, (), NOW)
    assert load_certificate(made.file) == made
    text = made.file.read_text("ascii")
    file.write_text(text[text.index("-----BEGIN CERT") :])
    with pytest.raises(BadInputError, match="does not contain a certificate with its key"):
        load_certificate(file)
