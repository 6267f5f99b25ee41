"""What importers and exporters both speak: the record in an export, and Foxglove's messages."""
