"""Types of messages in MCAP files and bags: Foxglove's in protobuf, which Rerun reads too, and ROS 2's."""

from functools import cache
from typing import Any

from capture_app.common.optional_packages import load_optional

ROS_BAGS = "ROS bags"
"""What the package rosbags is needed for, in words."""


def foxglove_message(name: str) -> Any:
    """Return the class of a Foxglove message, such as CompressedImage. Raises NotAvailableError."""
    return getattr(load_optional(f"foxglove_schemas_protobuf.{name}_pb2", "export", "MCAP"), name)


@cache
def ros_messages() -> Any:
    """Return the types of ROS 2's messages, as of Humble. Raises NotAvailableError without rosbags."""
    typesys = load_optional("rosbags.typesys", "ros", ROS_BAGS)
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
