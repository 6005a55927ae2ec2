"""Shim et al. 2019: slope and step height from an exoskeleton's legs."""
