"""The surroundings of the walk: route, terrain, objects, bystanders."""
