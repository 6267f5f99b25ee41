"""Sessions rendered from a recipe: the engine takes the burst in virtual time, a scene is the view."""
