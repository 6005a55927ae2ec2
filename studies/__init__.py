"""Experiments of papers: each says what its cases are, runs one, and lays the paper's table beside ours."""
