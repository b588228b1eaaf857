"""A stand-in for the NAOqi of a Pepper: the real protocol, in front of the simulated robot."""
