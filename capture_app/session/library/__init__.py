"""What people do with sessions on disk: list them quickly, rename, annotate, trash and restore them.

Imports `reading`, `format` and `files`; a session that is being written is never touched.
"""
