"""Rotations, frames through time, and the wearer's bodies as a rigid tree."""
