"""The commands of `reconstruct`, one module each."""
