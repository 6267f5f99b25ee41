"""What the screen costs, and how soon it answers."""
