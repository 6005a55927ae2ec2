"""Sensor models: each turns true motion, loads or pictures into the samples that the real part would give."""
