"""The process with one camera: driver, engine, spool and upload.

Imports `wire`; a sibling of `leader`, which it only meets over the network.
"""
