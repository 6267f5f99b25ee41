"""The mode Sessions: browse, rename, export and process what is on disk."""
