"""Names of the file formats that can be opened; a module of its own, so that the command line need not import them."""

FILE_FORMATS = (
    "mcap",
    "rosbag1",
    "rosbag2",
    "euroc",
    "tum",
    "7scenes",
    "openloris",
    "strayscanner",
    "record3d",
    "vrs",
    "table",
)
