"""A method: its interface, its scores and its words, and how sure scores are."""
