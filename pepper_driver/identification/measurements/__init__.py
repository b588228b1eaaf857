"""Measurements of a robot before its models: when currents answer, friction, the scale of torques, speeds."""
