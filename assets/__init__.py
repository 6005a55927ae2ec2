"""Bodies as MJCF leaf files."""
