"""Rigs larger than one leader can serve: relays, clock-only members, and succession of leaders."""
