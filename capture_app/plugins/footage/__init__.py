"""Methods that align recordings without common times."""
