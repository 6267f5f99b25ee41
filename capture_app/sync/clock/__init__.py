"""From time messages to a time map: arithmetic that imports nothing but the standard library."""
