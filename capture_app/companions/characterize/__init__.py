"""Character of a camera: its frame rate, timestamps, starts and phase moves, measured."""
