"""Sessions on disk, the only bridge from capture to reconstruction.

From the ground up: `files`, `format`, `reading`, `writing`, `importers` and `exporters`. Imports nothing of
the engine, so that `reconstruction` can read a session without it.
"""
