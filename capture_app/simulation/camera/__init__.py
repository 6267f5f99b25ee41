"""The driver of simulated cameras: virtual sensors in real time, opened as real ones; on `rendering`."""
