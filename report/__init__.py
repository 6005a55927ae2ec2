"""The output of a run: HTML report, figures, film, Rerun file."""
