"""What views draw with: lines of text that send only what differs, and dots and traces."""
