"""What the robot can do, one YAML file each."""
