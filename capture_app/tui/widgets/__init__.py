"""Widgets that modes share: lines, plots, images, contact sheets."""
