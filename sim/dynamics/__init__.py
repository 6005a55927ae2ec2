"""Forward simulation of the walk: real contacts under the feet, a whole-body controller, no hand at the root."""
