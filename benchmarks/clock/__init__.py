"""What clocks reach: laws of delay in virtual time, emulated links, many clients of one leader."""
