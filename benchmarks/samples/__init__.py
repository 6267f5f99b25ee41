"""Sample sessions rendered from a recipe: the engine takes the burst in virtual time, of a rendered scene."""
