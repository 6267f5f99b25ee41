"""Engines of a leader and a client: membership, time, triggers, and failover."""
