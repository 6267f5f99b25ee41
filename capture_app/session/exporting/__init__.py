"""Export of a session: exporter interface and requirements, images in order, lenses, tables, videos."""
