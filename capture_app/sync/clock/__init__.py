"""From time messages to a time map: samples, bounds on the offset, skew and their uncertainty.

Arithmetic alone: it imports nothing but the standard library and msgspec.
"""
