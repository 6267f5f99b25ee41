"""Depth of nearly blank walls: wide windows over what is blank alone, and planes that many points lie on."""
