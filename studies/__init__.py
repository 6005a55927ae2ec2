"""Experiments of the papers: each defines its cases, runs one, and compares its table with the paper's."""
