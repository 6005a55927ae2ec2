"""Bodies as MJCF leaf files."""

from importlib import resources


def mjcf(name: str) -> str:
    """Text of the file of a body."""
    return resources.files(__name__).joinpath("mjcf", f"{name}.xml").read_text()
