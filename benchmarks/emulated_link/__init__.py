"""Network namespaces on this machine, joined by plain veth cables and emulated WiFi links (Linux, root)."""
