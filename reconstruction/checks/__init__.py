"""What a comparison shows or measures without a method of its own, a folder each.

Each is a plugin: found by its entry point, imported by nothing, and deleted with its folder and that line.
"""
