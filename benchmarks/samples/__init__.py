"""Sample sessions from a recipe: the engine takes the burst of a rendered scene in virtual time."""
