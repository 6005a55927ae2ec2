"""Predicted locomotion modes of coming steps: run, files, scores, figures."""
