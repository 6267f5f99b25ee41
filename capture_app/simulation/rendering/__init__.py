"""From a scene to the picture that a rolling-shutter camera takes of it.

Imports `scenes` and `devices`.
"""
