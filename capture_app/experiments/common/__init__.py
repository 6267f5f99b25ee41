"""What every experiment shares: the shape of its figures, plots, trials on all cores."""
