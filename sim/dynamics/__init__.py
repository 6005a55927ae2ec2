"""Forward simulation of the walk: contacts under the feet and a whole-body controller, no wrench at the root."""
