"""The page that a comparison ends in, and its words.

Renders `scores`; computes nothing.
"""
