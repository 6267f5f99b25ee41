"""What a camera's frame stamps say: period and phase of its stream, dropped frames, the step stamps come in.

Imports nothing but the standard library; moves no phase.
"""
