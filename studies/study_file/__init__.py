"""Studies as files: methods compared on walks under every combination of variations and faults."""
