"""Camera images: the renderer, lenses, image sensors, depth."""
