"""Films and pictures of a log, drawn off-screen: the robot in space, and beside it what its joints felt."""

from typing import Literal

Format = Literal["mp4", "gif", "png"]

View = Literal["front", "left", "right", "back"]
"""Side from which the robot is seen."""
