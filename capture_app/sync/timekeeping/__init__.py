"""Timekeeping of a client: the schedule of its time requests, and the accuracy of its clock."""
