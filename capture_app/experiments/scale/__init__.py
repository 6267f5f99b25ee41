"""Thousands of clocks for long: one leader beside a tree of relays."""
