"""What views draw with: lines of text that send only what differs, their parts, and dots and traces."""
