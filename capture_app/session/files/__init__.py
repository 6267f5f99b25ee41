"""Files that survive a power cut: durable writes, locks, output folders, free space."""
