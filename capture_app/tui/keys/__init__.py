"""Which keys do what: the help that shows it, the palette that finds it, and the file that changes it.

Imports nothing of the modes: it reads the bindings of whatever screens there are.
"""
