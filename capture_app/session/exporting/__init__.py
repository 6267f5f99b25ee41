"""Exporting a session: what an exporter states about itself, and what exporters share.

The images in order, poses and lenses, tables, videos. The exporters are plugins, in `capture_app/exporters`.
"""
