"""Protocols of other programs: phones with libsoftwaresync or RecSync."""
