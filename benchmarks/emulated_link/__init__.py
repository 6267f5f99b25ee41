"""Network namespaces on this machine, joined by bare cables and by emulated wireless links (Linux, root)."""
