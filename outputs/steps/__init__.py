"""Steps estimated from the legs: run, files, scores, figures."""
