"""Identity of this machine, the machines it knows, pairing, and sealed datagrams."""
