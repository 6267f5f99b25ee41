"""Reading a session: opening, verifying and summarizing it, without changing it.

Imports `format` and `files`.
"""
