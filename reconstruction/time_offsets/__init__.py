"""Time offsets of a session's cameras, from a blinking lamp or from motion; begin at `session_offsets`."""
