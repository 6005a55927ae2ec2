"""The libraries that integrate depth images into a terrain map."""

BACKENDS = NUMBA, OPEN3D = ("numba", "open3d")
"""Names of the backends, the default first: our own kernels, and the volume of Open3D."""
