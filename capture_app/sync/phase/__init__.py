"""Phase alignment of one camera's stream with the frame grid of the rig."""
