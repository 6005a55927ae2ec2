"""Samples between two programs while they are measured: sender, receiver, order, recorder."""
