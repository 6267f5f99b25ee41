"""One burst on its leader, from the trigger to the manifest, resumed after a crash."""
