"""Recordings in which a person marks each touch."""
