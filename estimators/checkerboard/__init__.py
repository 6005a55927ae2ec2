"""The checkerboard on a shoe in the image of the other shoe's camera: corners and pose."""
