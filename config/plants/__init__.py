"""Parameters of simulated robots, one YAML file each."""
