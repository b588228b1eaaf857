"""Fitting of models and thresholds to recordings of free motion."""
