"""A package, so that its tests import the helper modules of the folder above."""
