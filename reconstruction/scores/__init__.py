"""What is measured on a result, with its uncertainty, and the structure of `metrics.json`.

Imports `session` and `common`.
"""
