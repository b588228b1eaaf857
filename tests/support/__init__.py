"""Shared by tests: samples, doubles and checks, a module for each subject."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
