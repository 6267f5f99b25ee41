"""Sensors, links and rigs in virtual time, made of `devices` and `network`; `rendering` films `scenes`."""
