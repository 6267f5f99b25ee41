"""Mode Shoot: previews, the settings of the next take, and its result."""
