"""What several exports share: images in order, poses, tables, videos.

Knows no program that an export is for.
"""
