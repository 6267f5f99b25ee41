"""Time offsets of a session's cameras, from a blinking lamp or from motion; see `session_offsets` first."""
