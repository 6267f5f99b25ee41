"""Export of a session: what an exporter states and needs, images in order, lenses, tables, videos."""
