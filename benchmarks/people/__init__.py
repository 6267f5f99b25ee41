"""People in 3D: a drawn figure with its truth, and recordings of others."""
