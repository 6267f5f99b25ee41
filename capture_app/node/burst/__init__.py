"""One burst at its leader, from the trigger to the manifest, and again after a crash.

Imports `wire`; the leader holds as many of these as bursts are under way.
"""
