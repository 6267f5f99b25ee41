"""A camera's sensor in virtual time, and the models of it by name.

Imports no other wing of `simulation`.
"""
