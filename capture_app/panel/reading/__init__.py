"""Reads panels in pictures: finds the frame, measures each lamp's light, tells the time and its error."""
