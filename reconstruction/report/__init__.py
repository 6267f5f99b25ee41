"""The reports of `compare` and `dose`: one HTML page each, made from templates, and its words.

Renders `scores`; computes nothing.
"""
