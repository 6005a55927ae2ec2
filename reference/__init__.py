"""Published figures that reports and experiments compare with; each file names its source."""
