"""The paper's panel of LEDs, to build: a sketch for an Arduino, its wiring, and the frame to print."""
