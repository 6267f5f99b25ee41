"""Sessions of a folder: list, rename, annotate, trash and restore them."""
