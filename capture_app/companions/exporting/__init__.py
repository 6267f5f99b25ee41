"""Export of sessions in the formats of other programs."""
