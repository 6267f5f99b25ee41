"""The command `batch`: many sessions and instants as independent units, in processes or on SLURM.

Imports `multiview`, `report`, `calibration`, `session` and `common`.
"""
