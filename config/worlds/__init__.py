"""What may stand, hang or fly around a simulated robot, one YAML file each."""
