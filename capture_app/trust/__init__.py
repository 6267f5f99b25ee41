"""Who this machine is to others, and whom it knows: an identity, pins, and TLS that goes by them alone.

What a user's processes have in common lies in one folder, so that those of one machine need no ceremony.
Datagrams are sealed with keys that are handed out over such streams.
"""
