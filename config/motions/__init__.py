"""Motions, one YAML file each."""
