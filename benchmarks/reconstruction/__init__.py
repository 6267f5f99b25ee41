"""What depth and clouds are worth beside a truth and beside simpler ways."""
