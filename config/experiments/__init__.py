"""How robots are moved and pushed, one YAML file each."""
