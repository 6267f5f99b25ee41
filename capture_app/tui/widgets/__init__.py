"""What modes share: lines, plots, pictures, contact sheets."""
