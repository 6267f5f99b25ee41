"""The path of a moving object through space, by all frames of all cameras."""
