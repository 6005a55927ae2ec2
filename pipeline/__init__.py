"""Runs estimators on whole recordings and on live samples, and writes the files of their estimates."""
