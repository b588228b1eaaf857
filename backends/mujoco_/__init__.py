"""A simulated Pepper: MuJoCo with DC motors, gears with backlash and friction, motor boards and encoders."""

from pepper_driver.backends.mujoco_.backend import MujocoBackend, from_uri

__all__ = ["MujocoBackend", "from_uri"]
