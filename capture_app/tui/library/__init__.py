"""Mode Sessions: browse, rename, export and process the sessions on disk."""
