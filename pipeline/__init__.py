"""Estimators on whole recordings and on live samples, and the files of their estimates."""
