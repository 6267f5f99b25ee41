"""The reports of `compare` and `tolerance`: one HTML page each, made from templates, and its words.

Renders `scores`; computes nothing.
"""
