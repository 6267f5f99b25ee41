"""How well the time is read off photographs of panels."""
