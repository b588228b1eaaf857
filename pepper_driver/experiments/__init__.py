"""Experiments: planned to the last contact before anything moves, and played the same on every backend."""
