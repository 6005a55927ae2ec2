"""Messages of ROS 1, in its bags and in MCAP files, as messages of ROS 2: their definitions and their bytes."""

from __future__ import annotations

import re
from functools import cache

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stridetwin.streams.recording.ros_types import Definitions, check_types, typestore

_WITHOUT_SEQ = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
"""Types that ROS 2 defines otherwise than ROS 1, whose headers have a field `seq`."""


@cache
def _noetic() -> Typestore:
    """The standard types of the last release of ROS 1, which no release has changed since 2010."""
    return get_typestore(Stores.ROS1_NOETIC)


def to_ros2_name(name: str) -> str:
    """ROS 2 name of a message type: `sensor_msgs/msg/Imu` of ROS 1's `sensor_msgs/Imu`; other names stay."""
    return re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", name)


def find_definition(name: str, text: str) -> str:
    """ROS 1 definition of a type, with all types that it needs.

    A standard type has its standard definition, as converters have written schemas that lack the types inside.

    Args:
        name: ROS 2 name of the type.
        text: Definition in the file, which is returned for other types.
    """
    # rosbags lists some types of ROS 1, such as transforms, among those of ROS 2 alone
    store = next((store for store in (_noetic(), typestore()) if name in store.fielddefs), None)
    return text if store is None else str(store.generate_msgdef(name, ros_version=1)[0])


class Ros1Types:
    """The message types of one source of ROS 1 messages."""

    def __init__(self) -> None:
        """Begins without types; those that are converted are checked against the limits of one file together."""
        self._store = get_typestore(Stores.EMPTY)
        self._definitions = Definitions()

    def to_ros2_definition(self, name: str, text: str) -> str:
        """A ROS 1 definition converted to ROS 2.

        Args:
            name: ROS 2 name of the type.
            text: Its ROS 1 definition.

        Returns:
            Definition as in an MCAP `ros2msg` schema; "" if the text cannot be parsed or is too long.
        """
        try:
            if name not in self._store.fielddefs:  # of the types that are converted already
                self._definitions.add(text)  # refuses texts that are too long together
                types = get_types_from_msg(text, name)
                check_types(types)
                # the conversion to CDR drops a header's `seq`, so the types must not have it
                ours = {n: typestore().fielddefs[n] for n in _WITHOUT_SEQ}
                self._store.register(types | ours)
            return str(self._store.generate_msgdef(name, ros_version=2)[0])
        except Exception:  # the parser raises several unrelated kinds
            return ""

    def to_cdr(self, raw: bytes, name: str) -> bytes:
        """The CDR bytes of a ROS 1 message of a type that `to_ros2_definition` has converted.

        Args:
            raw: Bytes of the message as ROS 1 serialises it.
            name: ROS 2 name of the type.

        Raises:
            ValueError: The bytes are no such message.
        """
        try:
            return bytes(self._store.ros1_to_cdr(raw, name))
        except Exception as error:  # the generated code does not validate its input: struct, index, memory errors
            raise ValueError(f"not a {name} of ROS 1: {' '.join(str(error).split())[:120]}") from error
