"""Phones as cameras: the web page that a phone opens by a QR code, and the gateway that serves it."""
