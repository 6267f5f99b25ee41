"""FreeMoCap: its recordings, read and written."""
