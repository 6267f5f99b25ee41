"""Other programs, a folder or module each: the reader and the writer of its files."""
