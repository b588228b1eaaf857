"""Films and pictures of a log, drawn off-screen: the robot in space, and next to it the contacts of its joints."""

from typing import Literal

Format = Literal["mp4", "gif", "png"]

View = Literal["front", "left", "right", "back"]
"""Side from which the robot is seen."""
