"""Where each camera stands at each instant, found anew from the pictures (the paper's pinwheel).

Imports `session` and `common`.
"""
