"""ALMotion of the stand-in, without its calls: what moves the robot 50 times a second."""
