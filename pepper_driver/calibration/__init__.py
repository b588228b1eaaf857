"""Calibration: how near a simulated robot comes to recordings of real ones, and a plant that comes nearer."""
