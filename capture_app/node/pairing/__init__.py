"""How machines become known to each other over a stream: the leader's part of it, and the other machine's.

The arithmetic and the kept pins are in `capture_app.trust`; here is who says what, and what a person is told.
"""
