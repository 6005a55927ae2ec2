"""Sensor placement: positions on the body are swept or searched, and compared on the same walks."""
