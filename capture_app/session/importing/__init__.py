"""Importing recordings: what an importer states about itself, and what importers share.

Sources, times, alignment, calibrations. The importers are plugins, in `capture_app/importers`.
"""
