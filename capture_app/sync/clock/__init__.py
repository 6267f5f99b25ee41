"""From time messages to a time map: samples, bounds on the offset, skew, and an honest error.

Arithmetic alone: it imports nothing but the standard library, so that every estimate can be tested by
numbers.
"""
