"""Jao, Wang and Shkel 2020: two shoes that see each other."""
