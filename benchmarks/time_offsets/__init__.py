"""How wrong the times of cameras are that were measured from pictures, beside doing nothing."""
