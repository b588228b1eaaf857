"""What the way between a program and the robot costs, one YAML file each."""
