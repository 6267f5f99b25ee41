"""From a scene to the picture a rolling-shutter camera takes of it; imports `scenes` and `devices`."""
