"""From a picked frame to the leader's disk: encoding, the spool on the node's own disk, upload, receipt.

Imports `wire`; knows single images, not bursts.
"""
