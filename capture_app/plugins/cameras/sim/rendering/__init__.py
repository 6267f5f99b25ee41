"""Images of a scene as rolling-shutter cameras capture them."""
