"""Gaussian splats of a moment, made from depth maps and optimized on the processor."""
