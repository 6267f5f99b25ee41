"""Shared helpers: geometry, brightness, image files, drawing, stage cache, native libraries."""
