"""Evaluation of observers: performs seeded runs, runs observers on them, scores their contacts, writes results."""
