"""Residuals: tracking errors beyond those of a free motion, by method."""
