"""First hour on a robot: one command from the first check to an archive that can be sent."""
