"""Folders of which only the names of the files matter."""


def touch_files(folder, *names):
    """Makes empty files with their folders below a folder; returns it."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder
