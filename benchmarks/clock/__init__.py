"""Accuracy of clocks: delay laws in virtual time, emulated links, many clients of one leader."""
