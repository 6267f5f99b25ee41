"""Phones as cameras: a page that any phone opens by a QR code, and the gateway that speaks for it.

May import `node.camera` and what lies below it, `sync.clock` and `trust`; the leader starts it as a process.
"""
