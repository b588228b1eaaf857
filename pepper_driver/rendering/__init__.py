"""Films and pictures of a log, drawn off-screen: the robot in space, and beside it what its joints felt."""
