"""Measurements of a robot before its models: the delay from a command to its effect, and more to come."""
