"""Exporters: sessions in the formats of other programs, one module a format, listed in `formats`."""
