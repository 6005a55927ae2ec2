"""The twin: terrain, wearer, gait, physics, sensors and truth."""
