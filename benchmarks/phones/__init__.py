"""Phones in a browser: the clock of their page, and a burst over an emulated link."""
