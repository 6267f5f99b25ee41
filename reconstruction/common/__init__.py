"""Basics for every study: geometry, brightness, image files, drawing, stage cache, native libraries."""
