"""Objects around a simulated robot, one YAML file each."""
