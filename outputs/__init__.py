"""Kinds of output, one folder each: how it is run, its files, scores, figures and live rows."""
