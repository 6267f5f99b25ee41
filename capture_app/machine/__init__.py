"""This computer: its cameras, clock, disk and network; doctor, boot service, measurements, repair."""
