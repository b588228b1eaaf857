"""Delays of the connection between a program and the robot, one YAML file each."""
