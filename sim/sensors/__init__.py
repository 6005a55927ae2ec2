"""Sensor models: each converts true motion, loads or images to the samples of the real part (`SensorModel`)."""
