"""Take pictures of the same instant with many ordinary cameras."""

__version__ = "0.1.0"
